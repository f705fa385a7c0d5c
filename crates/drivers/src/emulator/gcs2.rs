//! An emulated PI hexapod, or a stage of axes of their own, on a controller with GCS 2.

mod units;
use super::server::{Device, Server};
use std::time::{Duration, Instant};

/// One axis of the emulated stage.
#[derive(Debug, Clone, PartialEq)]
pub struct EmulatedAxis {
    /// The controller's name for it.
    pub name: String,
    /// Lower end of travel, in its unit.
    pub low: f64,
    /// Upper end of travel, in its unit.
    pub high: f64,
    /// What it is counted in, as the controller writes it.
    pub unit: Vec<u8>,
}

/// What is emulated.
#[derive(Debug, Clone, PartialEq)]
pub struct EmulatedStage {
    /// Its axes.
    pub axes: Vec<EmulatedAxis>,
    /// Whether the first six share one platform: the parts of the travel that are used may then sum to 1.5 at most.
    pub coupled: bool,
    /// mm or deg a second, of every axis.
    pub velocity: f64,
    /// Whether it knows where it is from the start.
    pub referenced: bool,
    /// How long a reference move takes.
    pub reference_ms: u64,
    /// Commands that it does not know.
    pub unknown: Vec<&'static str>,
}

impl EmulatedStage {
    /// A hexapod of 22.5 mm, 12.5 mm along Z, 10 degrees and 5 mm/s.
    pub fn hexapod() -> Self {
        Self::hexapod_and(&[])
    }

    /// The same with more axes of their own on its controller: their names, and the end of their travel each way.
    pub fn hexapod_and(more: &[(&str, f64)]) -> Self {
        let axis = |(name, end): &(&str, f64)| EmulatedAxis {
            name: (*name).into(),
            low: -end,
            high: *end,
            unit: ["DEG", "MM"][usize::from("XYZ".contains(name))].into(),
        };
        let ends = [
            ("X", 22.5),
            ("Y", 22.5),
            ("Z", 12.5),
            ("U", 10.0),
            ("V", 10.0),
            ("W", 10.0),
        ];
        Self {
            axes: ends.iter().chain(more).map(axis).collect(),
            coupled: true,
            velocity: 5.0,
            referenced: true,
            reference_ms: 150,
            unknown: Vec::new(),
        }
    }
}

/// What the emulated controller does with commands to stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Obeys {
    /// All of them.
    All,
    /// Only STP and HLT, not the single byte.
    OnlyLines,
    /// None.
    None,
}

/// No obstacles.
const FREE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// The emulated controller on its port.
pub type Gcs2Emulator = Server<Controller>;

impl Gcs2Emulator {
    /// Starts it on a free port of 127.0.0.1.
    ///
    /// # Errors
    /// What the system says when there is no port.
    pub fn serve(stage: EmulatedStage) -> std::io::Result<Self> {
        let n = stage.axes.len();
        Server::start(Controller {
            from: vec![0.0; n],
            goal: vec![0.0; n],
            velocities: vec![stage.velocity; n],
            pivot: [0.0; 3],
            began: Instant::now(),
            takes: Duration::ZERO,
            referenced: vec![stage.referenced; n],
            homing: None,
            error: 0,
            line: Vec::new(),
            obeys: Obeys::All,
            never_on_target: false,
            takes_along: 0.0,
            obstacles: FREE,
            heard: Vec::new(),
            stage,
        })
    }

    /// Where it really is, mm and deg, whatever it says.
    pub fn truth(&self) -> Vec<f64> {
        self.device().place()
    }
    /// Whether it really moves.
    pub fn moves(&self) -> bool {
        self.device().moves()
    }
    /// Which commands to stop it obeys from now on.
    pub fn set_obeys(&self, obeys: Obeys) {
        self.device().obeys = obeys;
    }
    /// Whether it says that it is not on target, wherever it stands.
    pub fn set_never_on_target(&self, never: bool) {
        self.device().never_on_target = never;
    }
    /// From now on every move of the first axis takes the third along by so much, mm, which the device says; 0 ends it.
    pub fn take_along(&self, mm: f64) {
        self.device().takes_along = mm;
    }
    /// Obstacles, mm: the first axis goes no farther either way, and says where it stands; infinite ones end it.
    pub fn block_first_axis(&self, between: [f64; 2]) {
        self.device().obstacles = between;
    }
    /// The error it reports next.
    pub fn set_error(&self, number: i32) {
        self.device().error = number;
    }
    /// Stops it as somebody else would, who then also reads the error.
    pub fn stop_by_hand(&self) {
        let mut device = self.device();
        device.stand();
        device.error = 0;
    }
    /// The lines and single bytes it heard, in order.
    pub fn heard(&self) -> Vec<String> {
        self.device().heard.clone()
    }
}

/// The state of the emulated controller.
pub struct Controller {
    stage: EmulatedStage,
    from: Vec<f64>,
    goal: Vec<f64>,
    velocities: Vec<f64>,
    pivot: [f64; 3],
    began: Instant,
    takes: Duration,
    referenced: Vec<bool>,
    /// Until when which axes are on a reference move.
    homing: Option<(Instant, Vec<usize>)>,
    error: i32,
    line: Vec<u8>,
    obeys: Obeys,
    never_on_target: bool,
    takes_along: f64,
    obstacles: [f64; 2],
    heard: Vec<String>,
}

impl Controller {
    fn part(&self) -> f64 {
        if self.takes.is_zero() {
            return 1.0;
        }
        (self.began.elapsed().as_secs_f64() / self.takes.as_secs_f64()).min(1.0)
    }

    fn moves(&mut self) -> bool {
        self.homing() || self.part() < 1.0
    }

    fn place(&self) -> Vec<f64> {
        let part = self.part();
        let between = |(a, b): (&f64, &f64)| a + part * (b - a);
        self.from.iter().zip(&self.goal).map(between).collect()
    }

    fn homing(&mut self) -> bool {
        match self.homing.take() {
            Some((until, axes)) if Instant::now() < until => {
                self.homing = Some((until, axes));
                true
            }
            Some((_, axes)) => {
                let place = self.place();
                (self.from, self.goal, self.takes) = (place.clone(), place, Duration::ZERO);
                for at in axes {
                    self.referenced[at] = true;
                    (self.from[at], self.goal[at]) = (0.0, 0.0);
                }
                false
            }
            None => false,
        }
    }

    fn stand(&mut self) {
        let place = self.place();
        (self.from, self.goal, self.takes) = (place.clone(), place, Duration::ZERO);
        if self.homing() {
            self.homing = None;
        }
    }

    fn index(&self, name: &str) -> Option<usize> {
        self.stage.axes.iter().position(|a| a.name == name)
    }

    /// The axes named, or all; `None` sets the error.
    fn chosen(&mut self, names: &[&str]) -> Option<Vec<usize>> {
        if names.is_empty() {
            return Some((0..self.stage.axes.len()).collect());
        }
        let found: Option<Vec<usize>> = names.iter().map(|n| self.index(n)).collect();
        if found.is_none() {
            self.error = 15;
        }
        found
    }

    /// Pairs of axis and value; `None` sets the error.
    fn pairs(&mut self, words: &[&str]) -> Option<Vec<(usize, f64)>> {
        if words.is_empty() || !words.len().is_multiple_of(2) {
            self.error = 1;
            return None;
        }
        let mut pairs = Vec::new();
        for pair in words.chunks(2) {
            let Some(at) = self.index(pair[0]) else {
                self.error = 15;
                return None;
            };
            let Ok(value) = pair[1].parse() else {
                self.error = 1;
                return None;
            };
            pairs.push((at, value));
        }
        Some(pairs)
    }

    fn reachable(&self, goal: &[f64]) -> bool {
        let inside = |(axis, v): (&EmulatedAxis, &f64)| (axis.low..=axis.high).contains(v);
        let used = |(axis, v): (&EmulatedAxis, &f64)| v.abs() / axis.high.max(-axis.low);
        let axes = || self.stage.axes.iter().zip(goal);
        // What comes after the six axes of a platform stands alone.
        let load: f64 = axes().take(6).map(used).sum();
        axes().all(inside) && (!self.stage.coupled || load <= 1.5)
    }

    fn with(&self, pairs: &[(usize, f64)]) -> Vec<f64> {
        // What is not named stays where it was told to go.
        let mut goal = self.goal.clone();
        for (at, value) in pairs {
            goal[*at] = *value;
        }
        goal
    }

    fn move_to(&mut self, mut goal: Vec<f64>) {
        let from = self.place();
        if goal[0] != from[0] && goal.len() > 2 {
            goal[2] += self.takes_along;
        }
        let [low, high] = self.obstacles;
        goal[0] = goal[0].clamp(low.min(from[0]), high.max(from[0]));
        let mut seconds: f64 = 0.0;
        for ((a, b), v) in from.iter().zip(&goal).zip(&self.velocities) {
            seconds = seconds.max((b - a).abs() / v);
        }
        self.takes = Duration::from_secs_f64(seconds);
        self.began = Instant::now();
        (self.from, self.goal) = (from, goal);
    }

    fn list(&self, which: &[usize], value: impl Fn(usize) -> Vec<u8>, says: &mut Vec<u8>) {
        for (i, at) in which.iter().enumerate() {
            let end = if i + 1 < which.len() { " \n" } else { "\n" };
            says.extend(format!("{}=", self.stage.axes[*at].name).bytes());
            says.extend(value(*at));
            says.extend(end.bytes());
        }
    }

    fn obey(&mut self, line: &str, says: &mut Vec<u8>) {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        let Some((command, rest)) = words.split_first() else {
            return;
        };
        let still = self.part() >= 1.0;
        match *command {
            unknown if self.stage.unknown.contains(&unknown) => self.error = 2,
            "*IDN?" => says.extend(b"(c) Emulated Instrumente, C-887, 0, 1.0\n"),
            "SAI?" => {
                let names: Vec<&str> = self.stage.axes.iter().map(|a| a.name.as_str()).collect();
                says.extend(format!("{}\n", names.join(" \n")).bytes());
            }
            "ERR?" => {
                says.extend(format!("{}\n", self.error).bytes());
                self.error = 0;
            }
            "POS?" | "ONT?" | "FRF?" | "TMN?" | "TMX?" | "VEL?" | "PUN?" => {
                let Some(which) = self.chosen(rest) else {
                    return;
                };
                let place = self.place();
                let value = |at: usize| {
                    let text = match *command {
                        "PUN?" => return self.stage.axes[at].unit.clone(),
                        "POS?" => format!("{:.6}", place[at]),
                        "ONT?" => u8::from(still && !self.never_on_target).to_string(),
                        "FRF?" => u8::from(self.referenced[at]).to_string(),
                        "TMN?" => format!("{:.6}", self.stage.axes[at].low),
                        "TMX?" => format!("{:.6}", self.stage.axes[at].high),
                        _ => format!("{:.6}", self.velocities[at]),
                    };
                    text.into_bytes()
                };
                self.list(&which, value, says);
            }
            "VMO?" => {
                if let Some(pairs) = self.pairs(rest) {
                    let yes = self.reachable(&self.with(&pairs));
                    says.extend(if yes { b"1\n" } else { b"0\n" });
                }
            }
            "MOV" => self.obey_move(rest),
            "FRF" => {
                if let Some(axes) = self.chosen(rest) {
                    for at in &axes {
                        self.referenced[*at] = false;
                    }
                    let wait = Duration::from_millis(self.stage.reference_ms);
                    self.homing = Some((Instant::now() + wait, axes));
                }
            }
            "STP" | "HLT" => {
                if self.obeys != Obeys::None {
                    self.stand();
                    self.error = 10;
                }
            }
            "VEL" => self.obey_velocities(rest),
            "VLS?" => says.extend(format!("{:.6}\n", self.velocities[0]).bytes()),
            "VLS" => match rest {
                [v] if v.parse().is_ok_and(|v: f64| (0.0..=20.0).contains(&v)) => {
                    if let Ok(v) = v.parse() {
                        self.velocities.fill(v);
                    }
                }
                [v] if v.parse::<f64>().is_ok() => self.error = 8,
                _ => self.error = 1,
            },
            "SPI?" => {
                let [x, y, z] = self.pivot;
                says.extend(format!("X={x:.6} \nY={y:.6} \nZ={z:.6}\n").bytes());
            }
            "SPI" => self.obey_pivot(rest),
            _ => self.error = 2,
        }
    }

    fn obey_move(&mut self, rest: &[&str]) {
        let Some(pairs) = self.pairs(rest) else {
            return;
        };
        let goal = self.with(&pairs);
        if pairs.iter().any(|(at, _)| !self.referenced[*at]) {
            self.error = 5;
        } else if self.reachable(&goal) {
            self.move_to(goal);
        } else {
            self.error = 7;
        }
    }

    fn obey_velocities(&mut self, rest: &[&str]) {
        let Some(pairs) = self.pairs(rest) else {
            return;
        };
        if pairs.iter().any(|(_, v)| !(0.0..=20.0).contains(v)) {
            self.error = 8;
        } else {
            for (at, v) in pairs {
                self.velocities[at] = v;
            }
        }
    }

    fn obey_pivot(&mut self, rest: &[&str]) {
        let Some(pairs) = self.pairs(rest) else {
            return;
        };
        if self.place().iter().skip(3).any(|v| *v != 0.0) {
            self.error = 9;
        } else {
            for (at, v) in pairs.into_iter().filter(|(at, _)| *at < 3) {
                self.pivot[at] = v;
            }
        }
    }
}

impl Device for Controller {
    fn hear(&mut self, byte: u8, says: &mut Vec<u8>) {
        let homing = self.homing();
        match byte {
            5 => {
                let mask = (1u32 << self.stage.axes.len()) - 1;
                let moving = if self.moves() { mask } else { 0 };
                says.extend(format!("{moving:X}\n").bytes());
            }
            7 => says.extend([if homing { 176 } else { 177 }, b'\n']),
            24 => {
                self.heard.push("#24".into());
                if self.obeys == Obeys::All {
                    self.stand();
                    self.error = 10;
                }
            }
            b'\n' => {
                let line = String::from_utf8_lossy(&self.line).into_owned();
                self.line.clear();
                // On a reference move it takes no lines.
                if !homing || line == "STP" {
                    self.obey(&line, says);
                }
                self.heard.push(line);
            }
            other => self.line.push(other),
        }
    }

    fn tick(&mut self, _: &mut Vec<u8>) {}
}
