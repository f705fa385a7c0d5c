//! `scopeservo init --ask`: what an instrument is made of, question by question, and the description that follows from the answers.

use crate::error::CliError;
use crate::nearby::Nearby;
use std::io::BufRead;

/// Asks, and reads the answers line by line.
pub(crate) struct Interview<'a> {
    lines: &'a mut dyn BufRead,
    /// Shows a line to whoever answers.
    show: &'a dyn Fn(&str),
    ports: &'a [Nearby],
    cameras: &'a [Nearby],
}

/// What drives something, and what is said of it in the file.
struct Driven {
    table: String,
    /// Whether it may speak for other devices as well.
    is_program: bool,
    /// The ends of travel are in its table.
    has_travel: bool,
}

impl<'a> Interview<'a> {
    pub(crate) fn new(
        lines: &'a mut dyn BufRead,
        show: &'a dyn Fn(&str),
        ports: &'a [Nearby],
        cameras: &'a [Nearby],
    ) -> Self {
        Self {
            lines,
            show,
            ports,
            cameras,
        }
    }

    /// A description of the instrument.
    ///
    /// # Errors
    /// [`CliError::Usage`] when the answers end too early.
    pub(crate) fn description(&mut self) -> Result<String, CliError> {
        let name = self.ask("What is the instrument called?", Some("my microscope"))?;
        let stage = self.stage()?;
        let (camera, camera_table) = self.camera(stage.is_program)?;
        let nosepiece = self.nosepiece(stage.is_program)?;
        let objectives = match nosepiece.as_str() {
            "stage" => Vec::new(),
            kind => self.objectives(kind == "none")?,
        };
        let limits = match stage.has_travel {
            true => String::new(),
            false => self.limits()?,
        };
        let change = match nosepiece.as_str() {
            "none" => String::new(),
            _ => self.change()?,
        };
        Ok(format!(
            "# What this instrument is made of and what it may do. Units are in the names: um, deg, ms.\n\
             # `scopeservo doctor` checks it without moving anything; `scopeservo init FILE` writes one with every key explained.\n\n\
             name = {}\n\n{}{camera_table}\n[devices]\nstage = \"stage\"\ncamera = \"{camera}\"\nnosepiece = \"{nosepiece}\"\n{}{limits}{change}",
            quoted(&name),
            stage.table,
            objectives.concat(),
        ))
    }

    /// One line; Enter takes `usual`, where there is one.
    fn ask(&mut self, question: &str, usual: Option<&str>) -> Result<String, CliError> {
        loop {
            let offered = usual.map_or(String::new(), |u| format!(" [{u}]"));
            (self.show)(&format!("{question}{offered}"));
            let mut line = String::new();
            let read = self.lines.read_line(&mut line);
            if !matches!(read, Ok(n) if n > 0) {
                return Err(CliError::Usage(
                    "the answers ended before all was asked, and nothing was written: `scopeservo init` without --ask writes a file to edit".into(),
                ));
            }
            let said: String = line.trim().chars().filter(|c| !c.is_control()).collect();
            match (said.as_str(), usual) {
                ("", Some(usual)) => return Ok(usual.into()),
                ("", None) => {
                    (self.show)("This has no usual answer, as a wrong one could do harm.")
                }
                _ => return Ok(said),
            }
        }
    }

    /// One of some words.
    fn choose(
        &mut self,
        question: &str,
        words: &[&'static str],
        usual: Option<&str>,
    ) -> Result<&'static str, CliError> {
        loop {
            let question = format!("{question} ({})", words.join(", "));
            let said = self.ask(&question, usual)?.to_lowercase();
            if let Some(word) = words.iter().find(|word| **word == said) {
                return Ok(word);
            }
            (self.show)("Type one of these words.");
        }
    }

    /// So many numbers that make sense together.
    fn numbers<const N: usize>(
        &mut self,
        question: &str,
        usual: Option<&str>,
        make_sense: impl Fn(&[f64; N]) -> bool,
    ) -> Result<[f64; N], CliError> {
        loop {
            let said = self.ask(question, usual)?;
            let words = said.split([' ', ',']).filter(|w| !w.is_empty());
            let values: Vec<f64> = words.filter_map(|w| w.parse().ok()).collect();
            match <[f64; N]>::try_from(values) {
                Ok(values) if values.iter().all(|v| v.is_finite()) && make_sense(&values) => {
                    return Ok(values);
                }
                _ => (self.show)("That cannot be; give numbers such as -3000 500."),
            }
        }
    }

    fn stage(&mut self) -> Result<Driven, CliError> {
        let kinds = ["program", "gcs2", "gcode", "sangaboard"];
        let question = "What drives the stage: a program of yours, a PI GCS 2 controller, a G-code board or a Sangaboard?";
        let kind = self.choose(question, &kinds, Some("program"))?;
        if kind == "program" {
            let command = self.ask("Which command starts it?", Some("python3 my_driver.py"))?;
            let words: Vec<String> = command.split_whitespace().map(quoted).collect();
            return Ok(Driven {
                table: format!("[drivers.stage]\nprogram = [{}]\n", words.join(", ")),
                is_program: true,
                has_travel: false,
            });
        }
        for Nearby { path, what } in self.ports {
            (self.show)(&format!("  found here: {path} ({what})"));
        }
        let first = self.ports.first().map(|port| port.path.clone());
        let at = self.ask(
            "Where is it: a serial port, or ADDRESS:PORT?",
            first.as_deref().or(Some("/dev/ttyUSB0")),
        )?;
        let is_tcp = at.rsplit_once(':').is_some_and(|(host, port)| {
            port.parse::<u16>().is_ok() && !host.is_empty() && !host.contains('/')
        });
        let key = if is_tcp { "tcp" } else { "serial" };
        let moves = ["microscope", "specimen"];
        let moves = self.choose("What does it move?", &moves, Some("specimen"))?;
        let kinematics = match moves {
            "microscope" => "moves_microscope",
            _ => "specimen_xy_on_top",
        };
        let ways = ["closer", "apart"];
        let z = "When z grows, do objective and specimen come closer or go apart? Look: a wrong answer drives the one into the other";
        let positive_z = self.choose(z, &ways, None)?;
        let head = format!(
            "[drivers.stage.{kind}]\n{key} = {}\n[drivers.stage.{kind}.settings]\nkinematics = \"{kinematics}\"\npositive_z = \"{positive_z}\"\n",
            quoted(&at)
        );
        let (axes, has_travel) = match kind {
            "gcs2" => (self.gcs2_axes()?, false),
            "gcode" => (self.gcode_axes()?, true),
            _ => (self.sanga_axes()?, true),
        };
        Ok(Driven {
            table: format!("{head}{axes}"),
            is_program: false,
            has_travel,
        })
    }

    fn gcs2_axes(&mut self) -> Result<String, CliError> {
        let mut text =
            String::from("coupled = true                    # a hexapod: all axes move together\n");
        for (axis, name) in [("x", "X"), ("y", "Y"), ("z", "Z")] {
            let name = self.ask(
                &format!("What does the controller call its axis {axis}?"),
                Some(name),
            )?;
            text += &format!(
                "[[drivers.stage.gcs2.settings.linear]]\naxis = \"{axis}\"\nname = {}\nrepeatability_um = 0.5            # from its data sheet\n\
                 arrival_tolerance_um = 1\n",
                quoted(&name)
            );
        }
        Ok(text)
    }

    fn gcode_axes(&mut self) -> Result<String, CliError> {
        let speed = self.numbers(
            "How fast may it move, um per second?",
            Some("2000"),
            |[v]: &[f64; 1]| *v > 0.0,
        )?[0];
        let mut text = format!(
            "speed_um_per_s = {speed}\nneeds_homing = true               # its counters mean nothing before it has found its switches\naxes = [\n"
        );
        for (axis, letter) in [("x", "X"), ("y", "Y"), ("z", "Z")] {
            let [from, to] = self.travel(axis)?;
            let steps = self.numbers(
                &format!("Steps per mm of {axis}?"),
                Some("400"),
                |[v]: &[f64; 1]| *v != 0.0,
            )?[0];
            text += &format!(
                "  {{ axis = \"{axis}\", letter = \"{letter}\", min_um = {from}, max_um = {to}, steps_per_mm = {steps}, repeatability_um = 5 }},\n"
            );
        }
        Ok(text + "]\n")
    }

    fn sanga_axes(&mut self) -> Result<String, CliError> {
        let mut text = String::new();
        for axis in ["x", "y", "z"] {
            let [from, to] = self.travel(axis)?;
            let step = self.numbers(
                &format!("How far is a step of {axis}, um?"),
                Some("0.1"),
                |[v]: &[f64; 1]| *v != 0.0,
            )?[0];
            text += &format!(
                "{axis} = {{ um_per_step = {step}, min_um = {from}, max_um = {to}, repeatability_um = 1 }}\n"
            );
        }
        Ok(text)
    }

    /// The safe ends of an axis: nobody can guess them.
    fn travel(&mut self, axis: &str) -> Result<[f64; 2], CliError> {
        let question = format!("From where to where may {axis} go, um?");
        self.numbers(&question, None, |[from, to]| from < to)
    }

    /// Which driver has the camera, and its table.
    fn camera(&mut self, stage_may: bool) -> Result<(&'static str, String), CliError> {
        let kinds = ["stage", "program", "mjpeg", "snapshot", "folder", "v4l"];
        let kinds = if stage_may { &kinds[..] } else { &kinds[1..] };
        let question = "What drives the camera: the program of the stage, another one, a camera on the web (mjpeg, snapshot), a folder that its own \
                        program fills, or a video device of Linux?";
        let usual = stage_may.then_some("stage");
        let kind = self.choose(question, kinds, usual.or(Some("mjpeg")))?;
        let latency = "latency_ms = 500                  # from the start of an exposure until the image is here, at the most\n";
        let table = match kind {
            "stage" => return Ok(("stage", String::new())),
            "program" => {
                let command = self.ask("Which command starts it?", Some("python3 my_camera.py"))?;
                let words: Vec<String> = command.split_whitespace().map(quoted).collect();
                format!("[drivers.camera]\nprogram = [{}]\n", words.join(", "))
            }
            "mjpeg" | "snapshot" => {
                let url = self.ask("At which address?", Some("http://192.168.1.20:8080/stream"))?;
                let age = match kind {
                    "mjpeg" => latency,
                    _ => {
                        "stale_ms = 200                    # how old an image in an answer can be\n"
                    }
                };
                format!(
                    "[drivers.camera.{kind}.settings]\nurl = {}\n{age}exposure.now_ms = 10              # automatic exposure must be off\n",
                    quoted(&url)
                )
            }
            "folder" => {
                let path = self.ask("Which folder?", Some("live"))?;
                format!(
                    "[drivers.camera.folder]\npath = {}\norder = \"newest\"\n{latency}exposure_ms = 10\n",
                    quoted(&path)
                )
            }
            _ => {
                for Nearby { path, what } in self.cameras {
                    (self.show)(&format!("  found here: {path} ({what})"));
                }
                let first = self.cameras.first().map(|c| c.path.clone());
                let device = self.ask("Which device?", first.as_deref().or(Some("/dev/video0")))?;
                let size = self.numbers(
                    "Width and height of its images, px?",
                    Some("1280 960"),
                    |v: &[f64; 2]| v.iter().all(|v| v.fract() == 0.0 && *v >= 64.0),
                )?;
                format!(
                    "[drivers.camera.v4l]\ndevice = {}\nwidth_px = {}\nheight_px = {}\nformat = \"yuyv\"\n{latency}",
                    quoted(&device),
                    size[0],
                    size[1]
                )
            }
        };
        Ok(("camera", table))
    }

    fn nosepiece(&mut self, stage_may: bool) -> Result<String, CliError> {
        let kinds = ["stage", "by-hand", "none"];
        let kinds = if stage_may { &kinds[..] } else { &kinds[1..] };
        let question = "The nosepiece: turned by the program of the stage, by hand when you are asked, or none, as there is one objective?";
        Ok(self.choose(question, kinds, Some("by-hand"))?.into())
    }

    fn objectives(&mut self, one: bool) -> Result<Vec<String>, CliError> {
        let mut all = Vec::new();
        loop {
            let question = match all.is_empty() {
                true => {
                    "An objective: its name, total magnification, aperture, and the size of a camera pixel on the specimen in um, like: 10x 100 0.25 1.1"
                }
                false => "The next one, or Enter when that is all",
            };
            let usual = (!all.is_empty()).then_some("that is all");
            let said = self.ask(question, usual)?;
            if said == "that is all" {
                return Ok(all);
            }
            let words: Vec<&str> = said.split_whitespace().collect();
            let numbers: Vec<f64> = words
                .iter()
                .skip(1)
                .filter_map(|w| w.parse().ok())
                .collect();
            let [magnification, aperture, scale] = numbers[..] else {
                (self.show)("Give a name and three numbers.");
                continue;
            };
            if words.len() != 4 {
                (self.show)("Give a name without blanks and three numbers.");
                continue;
            }
            let media = ["air", "water", "glycerol", "silicone", "oil"];
            let medium = self.choose("What does it work in?", &media, Some("air"))?;
            all.push(format!(
                "[[objective]]\nid = {}\nmagnification = {magnification}\nnumerical_aperture = {aperture}\num_per_px = {scale}\nimmersion = \"{medium}\"\n",
                quoted(words[0])
            ));
            if one {
                return Ok(all);
            }
        }
    }

    fn limits(&mut self) -> Result<String, CliError> {
        let mut text = String::from("[limits]\n");
        for axis in ["x", "y", "z"] {
            let question =
                format!("From where to where may {axis} go, um? Enter for all of its travel");
            let said = self.ask(&question, Some("all"))?;
            let words = said.split([' ', ',']).filter(|w| !w.is_empty());
            let values: Vec<f64> = words.filter_map(|w| w.parse().ok()).collect();
            match values[..] {
                [from, to] if from < to => text += &format!("{axis}_um = [{from}, {to}]\n"),
                _ if said == "all" => {}
                _ => {
                    (self.show)("Two numbers, the smaller first, like -8000 8000.");
                    return self.limits();
                }
            }
        }
        Ok(text)
    }

    fn change(&mut self) -> Result<String, CliError> {
        let question = "From which z on, away from the specimen, can no objective touch anything while the nosepiece turns, um? Or: anywhere, where the \
                        stage has no z or nothing can touch";
        loop {
            let said = self.ask(question, None)?;
            if said == "anywhere" {
                return Ok("[objective_change]\nanywhere = true\n".into());
            }
            match said.parse::<f64>() {
                Ok(z) if z.is_finite() => {
                    return Ok(format!(
                        "[objective_change]\nretract_z_um = {z}\nmargin_um = 50                    # how far from the expected focus an objective stops whose focus was never found\n"
                    ));
                }
                _ => (self.show)("A number, such as -2000, or: anywhere"),
            }
        }
    }
}

/// A text as a value: in single quotes, so that backslashes stay what they are, where it has none of those itself.
fn quoted(text: &str) -> String {
    match text.contains('\'') {
        true => format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\"")),
        false => format!("'{text}'"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_setup::Config;
    use std::path::Path;

    fn described(answers: &str) -> Result<(Config, String), CliError> {
        let (mut lines, ports) = (
            answers.as_bytes(),
            [Nearby {
                path: "/dev/serial/by-id/board".into(),
                what: "ttyUSB0".into(),
            }],
        );
        let text = Interview::new(&mut lines, &|_| {}, &ports, &[]).description()?;
        let config = Config::parse(&text, Path::new("scopeservo.toml"));
        Ok((config.unwrap_or_else(|e| panic!("{e}\n{text}")), text))
    }

    #[test]
    fn answers_become_a_description_that_is_valid() {
        // Enter everywhere, but where a wrong answer could do harm.
        let (config, _) = described("\n\n\n\n\n10x 100 0.25 1.1\n\n\n\n\n\n-2000\n").unwrap();
        assert_eq!(config.name, "my microscope");
        assert_eq!(config.devices.nosepiece, "by-hand");
        assert_eq!(config.objectives.len(), 1);
        // A board on the port that was found, a camera on the web, and no nosepiece.
        let (config, text) = described(
            "Upstairs\ngcode\n\nspecimen\ncloser\n1500\n0 50000\n\n0 30000\n\n-3000 500\n1600\nmjpeg\nhttp://10.0.0.2/s\nnone\n40x 400 0.65 0.27\n\n",
        )
        .unwrap();
        assert_eq!(
            (config.name.as_str(), config.drivers.len()),
            ("Upstairs", 2)
        );
        assert!(
            text.contains("serial = '/dev/serial/by-id/board'"),
            "{text}"
        );
        assert!(
            text.contains("min_um = -3000, max_um = 500, steps_per_mm = 1600"),
            "{text}"
        );
        // A controller on the network, a video device, a Windows path to a program of its own.
        let (config, text) = described(
            "It's\ngcs2\n10.0.0.3:50000\nmicroscope\napart\n\n\n\nprogram\nC:\\temp\\camera.exe --fast\nby-hand\n10x 100 0.25 1.1\n\n60x 600 1.2 0.2\nwater\n\n-8000 8000\n\n\nanywhere\n",
        )
        .unwrap();
        assert_eq!(config.name, "It's");
        assert!(
            text.contains("tcp = '10.0.0.3:50000'") && text.contains("positive_z = \"apart\""),
            "{text}"
        );
        let camera = config.drivers["camera"].program.clone().unwrap();
        assert_eq!(camera, ["C:\\temp\\camera.exe", "--fast"]);
        assert_eq!(config.objectives[1].numerical_aperture, 1.2);
        let (_, text) = described(
            "Bench\nsangaboard\n/dev/ttyACM0\nspecimen\ncloser\n-5000 5000\n\n-5000 5000\n\n-2000 2000\n0.05\nv4l\n\n640 480\nnone\n10x 100 0.25 1.1\n\n",
        )
        .unwrap();
        assert!(
            text.contains("z = { um_per_step = 0.05, min_um = -2000"),
            "{text}"
        );
    }

    #[test]
    fn what_makes_no_sense_is_asked_again_and_what_could_do_harm_has_no_usual_answer() {
        // Unknown words, limits in the wrong order, an objective without numbers, no height.
        let (config, text) =
            described("\nrobot\nprogram\n\n\nnone\n10x\n10x 100 0.25 1.1\n\n9 1\n-9 9\n\n\n")
                .unwrap();
        assert_eq!(config.objectives.len(), 1);
        assert!(text.contains("x_um = [-9, 9]"), "{text}");
        // Which way z goes, and where the nosepiece may turn, are never taken from Enter.
        for answers in [
            "\ngcs2\n\n\n\n\n\n",
            "\n\n\n\n\n10x 100 0.25 1.1\n\n\n\n\n\n\n\n",
            "",
        ] {
            let said = described(answers).unwrap_err().to_string();
            assert!(said.contains("nothing was written"), "{said}");
        }
    }
}
