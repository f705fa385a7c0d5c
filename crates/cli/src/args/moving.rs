//! How a run moves towards its goal.

use crate::error::CliError;
use clap::{Args, ValueEnum};
use scopeservo_servo::{Law, ServoOptions};

/// How the stage is moved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Method {
    /// The whole way at once, past the magnifications that are not needed.
    Direct,
    /// The paper's: a share of the error at a time, at each magnification until it converges.
    Paper,
}

impl Method {
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Direct => "direct",
            Self::Paper => "paper",
        }
    }
}

#[derive(Debug, Args)]
pub(crate) struct MovingArgs {
    /// How the stage is moved; direct unless --lambda asks for the paper's.
    #[arg(long, value_enum)]
    method: Option<Method>,
    /// Gain of the paper's method: the share of the error that one iteration takes away, above 0 up to 1; 0.2 unless told.
    #[arg(long, value_name = "F", allow_negative_numbers = true)]
    lambda: Option<f64>,
    /// Iterations at each magnification, at most.
    #[arg(long, value_name = "N", default_value_t = 64)]
    max_iterations: usize,
    /// Arrive only within this distance for sure; what is farther off, and as near as the stage gets, is refused with what the stage can do. A stage
    /// that does not come within 0.8 pixels in some moves may stay as far off as this. `[arrival]` in the description says the same for every run.
    #[arg(long, value_name = "UM", allow_negative_numbers = true)]
    within_um: Option<f64>,
    /// The same of the angle. What a stage cannot turn may be left up to this; without it, while the middle half of the target is in view.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    within_deg: Option<f64>,
}

impl MovingArgs {
    pub(crate) fn method(&self) -> Method {
        let asked = self.method.or(self.lambda.map(|_| Method::Paper));
        asked.unwrap_or(Method::Direct)
    }

    /// The gain, where there is one.
    pub(crate) fn lambda(&self) -> Option<f64> {
        let paper = self.method() == Method::Paper;
        paper.then(|| self.lambda.unwrap_or(ServoOptions::default().lambda))
    }

    /// The settings of the loop.
    pub(crate) fn options(&self) -> Result<ServoOptions, CliError> {
        let usage = |text: &str| Err(CliError::Usage(text.into()));
        if self.lambda.is_some_and(|l| !(l > 0.0 && l <= 1.0)) {
            return usage("--lambda must be above 0 and at most 1; the paper uses 0.2");
        }
        if self.lambda.is_some() && self.method() == Method::Direct {
            return usage(
                "--lambda is the gain of --method paper; direct control takes the whole way at once",
            );
        }
        if self.max_iterations == 0 {
            return usage("--max-iterations must be at least 1");
        }
        let within = [self.within_um, self.within_deg];
        if within
            .into_iter()
            .flatten()
            .any(|v| !(v > 0.0 && v.is_finite()))
        {
            return usage("--within-um and --within-deg must be above 0");
        }
        Ok(ServoOptions {
            within_um: self.within_um,
            within_deg: self.within_deg,
            law: match self.method() {
                Method::Direct => Law::Direct,
                Method::Paper => Law::Proportional,
            },
            lambda: self.lambda().unwrap_or(ServoOptions::default().lambda),
            max_iterations: self.max_iterations,
            ..ServoOptions::default()
        })
    }
}
