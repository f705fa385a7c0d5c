//! The progress bar, and the sink that shares events among bar, recorder and view writer.

use crate::views::ViewWriter;
use console::Term;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use scopeservo_report::Recorder;
use scopeservo_scope::{Frame, ObjectiveId};
use scopeservo_servo::{Event, FrameRole, Identity, Phase, Sink, Stamped};
use std::sync::OnceLock;
use std::time::Duration;

/// Shares of a run that its parts take, from experience: the bar should move evenly.
const FOCUS: f64 = 2.0;
const CALIBRATE: f64 = 4.0;
const SERVO: f64 = 12.0;

/// What is shown of work whose end is known, and of other work. The words give way where the terminal is narrow.
const BAR: &str = "{elapsed:>4} {bar:30} {percent:>3} %  {wide_msg}";
const SHORT_BAR: &str = "{elapsed:>4} {percent:>3} % {wide_msg}";
const SPINNER: &str = "{elapsed:>4} {spinner} {wide_msg}";
/// On a terminal of fewer columns the bar gives way to the words.
const NARROW: u16 = 80;
/// How often what is shown moves, so that everybody sees that something is under way, whether or not anything is told.
const TICK: Duration = Duration::from_millis(200);

/// All that is shown at once.
fn screen() -> &'static MultiProgress {
    static SCREEN: OnceLock<MultiProgress> = OnceLock::new();
    SCREEN.get_or_init(MultiProgress::new)
}

/// Does what writes a line while nothing is drawn over it.
pub(crate) fn beside<T>(write: impl FnOnce() -> T) -> T {
    screen().suspend(write)
}

/// Something whose end nobody knows.
pub(crate) fn spinner(what: String) -> ProgressBar {
    let bar = steady(ProgressBar::new_spinner(), SPINNER);
    bar.set_message(what);
    bar
}

/// From now on it is shown, and moves.
fn steady(bar: ProgressBar, template: &str) -> ProgressBar {
    let bar = screen().add(bar);
    bar.set_style(style(template));
    bar.enable_steady_tick(TICK);
    bar
}

/// How work whose end is known is shown on so many columns.
fn template(columns: u16) -> &'static str {
    match columns < NARROW {
        true => SHORT_BAR,
        false => BAR,
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

pub(crate) struct Watcher {
    pub(crate) recorder: Recorder,
    pub(crate) views: Option<ViewWriter>,
    bar: ProgressBar,
    done: f64,
    total: f64,
    first_error_um: f64,
}

/// A calibration takes so many views, about.
const CALIBRATION_VIEWS: f64 = 36.0;

impl Watcher {
    pub(crate) fn new(views: Option<ViewWriter>) -> Self {
        let (_, columns) = Term::stderr().size();
        let bar = steady(ProgressBar::new(1000), template(columns));
        Self {
            recorder: Recorder::new(),
            views,
            bar,
            done: 0.0,
            total: FOCUS + CALIBRATE,
            first_error_um: f64::NAN,
        }
    }

    /// The number of the last frame grabbed.
    pub(crate) fn last_frame(&self) -> Option<u64> {
        let mut events = self.recorder.events().iter().rev();
        events.find_map(|e| match e.event {
            Event::FrameGrabbed { sequence, .. } => Some(sequence),
            _ => None,
        })
    }

    pub(crate) fn finish(&self) {
        self.bar.finish_and_clear();
    }

    fn show(&self, within: f64) {
        let share = ((self.done + within) / self.total).clamp(0.0, 1.0);
        self.bar.set_position((share * 1000.0) as u64);
    }

    fn follow(&mut self, event: &Event) {
        match event {
            Event::Started { objectives, .. } => {
                let legs = objectives.len() as f64;
                self.total = (legs + 1.0) * (FOCUS + CALIBRATE) + legs * SERVO;
            }
            Event::PhaseStarted { phase, objective } => {
                let what = match phase {
                    Phase::Switch => "changing to",
                    Phase::Focus => "focusing with",
                    Phase::Identify => "looking whether it is",
                    Phase::Calibrate => "calibrating",
                    Phase::Servo => "servoing with",
                };
                self.first_error_um = f64::NAN;
                self.bar.set_message(format!("{what} {objective}"));
            }
            Event::Focused { .. } => self.done += FOCUS,
            Event::Identified {
                objective,
                identity,
            } => {
                // Who turned the nosepiece is told, bar or not, and before being asked again.
                self.bar
                    .suspend(|| tell!("{}", identified(objective, identity)));
            }
            Event::CalibrationView { index, .. } => {
                self.show(CALIBRATE * (*index as f64 / CALIBRATION_VIEWS).min(1.0));
                return;
            }
            Event::Calibrated { .. } => self.done += CALIBRATE,
            Event::Iteration {
                objective,
                iteration,
                error,
                inliers,
                converged,
                ..
            } => {
                let e = error.distance_um();
                if self.first_error_um.is_nan() {
                    self.first_error_um = e;
                }
                self.bar.set_message(format!(
                    "{objective} iteration {iteration}: {e:.2} um, {:.3} deg, {inliers} inliers",
                    error.angle_deg()
                ));
                // The error falls exponentially towards about half a micrometre.
                let way =
                    (self.first_error_um / e).ln() / (self.first_error_um / 0.5).ln().max(0.1);
                if *converged {
                    self.bar
                        .set_message(format!("{objective}: {e:.2} um, confirming"));
                }
                self.show(SERVO * way.clamp(0.0, 1.0));
                return;
            }
            Event::Lost {
                iteration, reason, ..
            } => {
                self.bar
                    .set_message(format!("iteration {iteration}: {reason}"));
            }
            _ => return,
        }
        if let Event::PhaseStarted {
            phase: Phase::Switch,
            ..
        } = event
        {
            // A finished servo leg is known by the next one's beginning.
            let whole = FOCUS + CALIBRATE;
            let legs = ((self.done - whole) / (whole + SERVO)).ceil().max(0.0);
            if self.done > whole {
                self.done = whole + legs * (whole + SERVO);
            }
        }
        self.show(0.0);
    }
}

/// What an image told, for whoever turned the nosepiece.
fn identified(told: &ObjectiveId, identity: &Identity) -> String {
    let scale = format!("the image has {:.3} um per pixel", identity.um_per_px);
    match (identity.as_told, &identity.looks_like) {
        (true, _) => format!("{told} is in: {scale}"),
        (false, Some(other)) => format!("that is not {told}: {scale}, as {other} has"),
        (false, None) => format!("that is not {told}: {scale}, which fits no objective"),
    }
}

impl Sink for Watcher {
    fn event(&mut self, event: Stamped) {
        self.follow(&event.event);
        if let Some(views) = &mut self.views {
            views.event(&event);
        }
        self.recorder.event(event);
    }

    fn frame(&mut self, frame: &Frame, role: FrameRole) {
        if let Some(views) = &mut self.views {
            views.frame(frame);
        }
        self.recorder.frame(frame, role);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use indicatif::{ProgressDrawTarget, TermLike};
    use std::io;
    use std::sync::{Arc, Mutex};

    /// A terminal of so many columns that keeps all lines written to it.
    #[derive(Debug, Clone)]
    struct Terminal {
        columns: u16,
        written: Arc<Mutex<Vec<String>>>,
    }

    impl TermLike for Terminal {
        fn width(&self) -> u16 {
            self.columns
        }
        fn move_cursor_up(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn move_cursor_down(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn move_cursor_right(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn move_cursor_left(&self, _: usize) -> io::Result<()> {
            Ok(())
        }
        fn write_line(&self, line: &str) -> io::Result<()> {
            self.write_str(line)
        }
        fn write_str(&self, text: &str) -> io::Result<()> {
            self.written.lock().unwrap().push(text.to_owned());
            Ok(())
        }
        fn clear_line(&self) -> io::Result<()> {
            Ok(())
        }
        fn flush(&self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn what_is_shown_fits_a_terminal_of_any_width() {
        for columns in [14, 20, 40, 79, 80, 120, 300] {
            for template in [template(columns), SPINNER] {
                let terminal = Terminal {
                    columns,
                    written: Arc::default(),
                };
                let bar = ProgressBar::with_draw_target(
                    Some(1000),
                    ProgressDrawTarget::term_like(Box::new(terminal.clone())),
                );
                bar.set_style(style(template));
                bar.set_message("calibrating the objective with the longest name that anybody has ever engraved on one");
                bar.set_position(450);
                bar.tick();
                let written = terminal.written.lock().unwrap();
                let longest = written
                    .iter()
                    .map(|line| console::measure_text_width(line))
                    .max();
                assert!(
                    (1..=usize::from(columns)).contains(&longest.unwrap_or(0)),
                    "{columns}: {written:?}"
                );
                if columns >= NARROW {
                    assert!(
                        written.concat().contains("calibrating the obj"),
                        "{written:?}"
                    );
                }
            }
        }
    }
}
