//! From the text of a description to the description, or to what is wrong and where.

use crate::SetupError;
use crate::check::{check, guess};
use crate::config::Config;
use crate::spelled::{ESCAPES, is_escape, spelled};
use crate::tables::{self, Unreadable};
use crate::template::schema_with;
use scopeservo_drivers::factory::{FACTORIES, Factory};
use std::path::Path;

impl Config {
    /// Reads a file.
    ///
    /// # Errors
    /// [`SetupError::Read`], [`SetupError::Parse`] with line and column, [`SetupError::Invalid`].
    pub fn read(path: &Path) -> Result<Self, SetupError> {
        let read = scopeservo_files::read_text(path, scopeservo_files::MAX_CONFIG_BYTES);
        let text = read.map_err(|source| SetupError::Read {
            path: path.into(),
            source,
        })?;
        Self::parse(&text, path)
    }

    /// Understands a text as if it were that file.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse(text: &str, path: &Path) -> Result<Self, SetupError> {
        Self::parse_with(text, path, FACTORIES)
    }

    /// The same with other drivers than ours.
    ///
    /// # Errors
    /// As [`Config::read`].
    pub fn parse_with(text: &str, path: &Path, known: &[Factory]) -> Result<Self, SetupError> {
        let unreadable = |error: Unreadable| {
            let at = error.span.clone().map_or(0, |s| s.start).min(text.len());
            let before = text.as_bytes()[..at].iter();
            let line = before.clone().filter(|&&b| b == b'\n').count() + 1;
            let column = before.rev().take_while(|&&b| b != b'\n').count() + 1;
            let hint = match is_escape(text, at) {
                true => ESCAPES,
                false => "",
            };
            SetupError::Parse {
                path: path.into(),
                line,
                column,
                what: format!("{}{hint}", with_guess(&error.message)),
            }
        };
        let (mut config, found): (Self, _) = tables::read(text, known).map_err(unreadable)?;
        spelled(text, &schema_with(known)).map_err(unreadable)?;
        for (name, own) in found {
            if let Some(driver) = config.drivers.get_mut(&name) {
                driver.own = own;
            }
        }
        config.path = path.into();
        config.text = text.into();
        check(&config, known)?;
        Ok(config)
    }

    /// What is read otherwise than it was written, in any text: lists with more values than are read, and paths with escapes.
    ///
    /// # Errors
    /// The sentence that [`Config::parse`] would say.
    #[doc(hidden)]
    pub fn is_spelled_as_meant(text: &str) -> Result<(), String> {
        spelled(text, &schema_with(FACTORIES)).map_err(|error| error.message)
    }
}

/// `unknown field ..., expected one of ...` with the nearest of them.
fn with_guess(message: &str) -> String {
    let message = message.trim_end();
    let mut quoted = message.split('`').skip(1).step_by(2);
    match (message.starts_with("unknown "), quoted.next()) {
        (true, Some(wrong)) => {
            let known: Vec<&str> = quoted.collect();
            let what = message.split('`').next().unwrap_or("unknown key").trim();
            let what = what.replace("field", "key").replace("variant", "value");
            match guess(wrong, known.iter().copied()) {
                Some(right) => format!("{what} '{wrong}'; did you mean '{right}'?"),
                None => format!("{what} '{wrong}'; there are {}", known.join(", ")),
            }
        }
        _ => message.replace('\n', " "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{TEMPLATE, TWIN_TEMPLATE};
    use scopeservo_scope::Immersion;

    fn parse(text: &str) -> Result<Config, SetupError> {
        Config::parse(text, Path::new("lab/scopeservo.toml"))
    }

    fn said(text: &str) -> String {
        parse(text).expect_err(text).to_string()
    }

    #[test]
    fn the_templates_are_valid() {
        let config = parse(TEMPLATE).unwrap();
        assert_eq!(config.devices.stage, "main");
        assert_eq!(
            config.resolve(&config.data_folder),
            Path::new("lab/scopeservo-data")
        );
        parse(TWIN_TEMPLATE).unwrap();
    }

    #[test]
    fn an_objective_works_in_air_unless_it_says_otherwise() {
        let objectives = "[[objective]]\nid = \"10x\"\nmagnification = 100\nnumerical_aperture = 0.25\num_per_px = 1.1\n\
             [[objective]]\nid = \"100x\"\nmagnification = 1000\nnumerical_aperture = 1.25\num_per_px = 0.1\nimmersion = \"oil\"\n";
        let by_hand = TWIN_TEMPLATE.replace("nosepiece = \"twin\"", "nosepiece = \"by-hand\"");
        let config = parse(&format!("{by_hand}\n{objectives}")).unwrap();
        let media: Vec<Immersion> = config.objectives.iter().map(|o| o.immersion).collect();
        assert_eq!(media, [Immersion::Air, Immersion::Oil]);
        let odd = format!("{by_hand}\n{}", objectives.replace("\"oil\"", "\"oill\""));
        let line = odd.lines().position(|l| l.contains("oill")).unwrap() + 1;
        let said = said(&odd);
        assert!(
            said.starts_with(&format!("lab/scopeservo.toml:{line}:"))
                && said.contains("did you mean 'oil'?"),
            "{said}"
        );
    }

    #[test]
    fn mistakes_are_named_with_their_place_and_a_guess() {
        let wrong = |from: &str, to: &str| said(&TWIN_TEMPLATE.replace(from, to));
        let key = wrong("retract_z_um", "retract_z");
        assert!(
            key.contains("unknown key 'retract_z'; did you mean 'retract_z_um'?"),
            "{key}"
        );
        let line = TWIN_TEMPLATE[..TWIN_TEMPLATE.find("retract_z_um").unwrap()]
            .lines()
            .count()
            + 1;
        assert!(
            key.starts_with(&format!("lab/scopeservo.toml:{line}:1: ")),
            "{key}"
        );
        let unit = wrong("x_um = ", "x_mm = ");
        assert!(unit.contains("did you mean 'x_um'?"), "{unit}");
        let odd = wrong("[limits]", "[quux]");
        assert!(
            odd.contains("unknown key 'quux'; there are name, drivers"),
            "{odd}"
        );
        let missing = wrong("camera = \"twin\"", "");
        assert!(missing.contains("missing field `camera`"), "{missing}");
        let kind = wrong("x_um = [", "x_um = [\"far\", ");
        assert!(kind.contains("invalid type"), "{kind}");
        let broken = wrong("[limits]", "[limits");
        assert!(broken.starts_with("lab/scopeservo.toml:"), "{broken}");
        let driver = wrong("camera = \"twin\"", "camera = \"twim\"");
        assert!(
            driver.contains("devices.camera is 'twim'") && driver.contains("did you mean 'twin'?"),
            "{driver}"
        );
        let both = wrong("retract_z_um", "anywhere = true\nretract_z_um");
        assert!(both.contains("exactly one of"), "{both}");
        let asked = said(&format!("{TWIN_TEMPLATE}\n[arrival]\nwithin_deg = 0\n"));
        assert!(
            asked.contains("arrival.within_deg is 0: it must be above 0"),
            "{asked}"
        );
        let sweep = said(&format!("{TWIN_TEMPLATE}\n[focus]\nsweep = \"slow\"\n"));
        assert!(
            sweep.contains("lab/scopeservo.toml:") && sweep.contains("invalid type"),
            "{sweep}"
        );
        let other = said(&format!("{TWIN_TEMPLATE}\n[focus]\nsweeps = true\n"));
        assert!(other.contains("did you mean 'sweep'?"), "{other}");
        let margin = wrong("margin_um = 0", "");
        assert!(
            margin.contains("margin_um belongs to retract_z_um"),
            "{margin}"
        );
        let kinds = wrong(
            "[drivers.twin.twin]",
            "[drivers.twin]\ntcp = \"localhost:1\"\n[drivers.twin.twin]",
        );
        assert!(
            kinds.contains("exactly one of program, tcp, twin"),
            "{kinds}"
        );
        let none = wrong("nosepiece = \"twin\"", "nosepiece = \"none\"");
        assert!(none.contains("exactly one objective"), "{none}");
        assert!(said("").contains("missing field `name`"));
    }

    #[test]
    fn a_sweep_is_asked_for_in_the_description_or_not() {
        for (said, sweep) in [
            ("", false),
            ("\n[focus]\n", false),
            ("\n[focus]\nsweep = false\n", false),
            ("\n[focus]\nsweep = true\n", true),
        ] {
            let text = format!("{TWIN_TEMPLATE}{said}");
            let config = Config::parse(&text, Path::new("x.toml")).unwrap();
            assert_eq!(config.focus.sweep, sweep, "{said}");
        }
    }
}
