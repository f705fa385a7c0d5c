//! An emulated board with Marlin: three axes and perhaps a turning one, a queue of commands, numbered lines, signs of being busy.

use super::server::{Device, Server};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// What is emulated.
#[derive(Debug, Clone, PartialEq)]
pub struct EmulatedBoard {
    /// Steps for a millimetre of X, Y and Z.
    pub steps_per_mm: [f64; 3],
    /// The firmware's own limits, mm: it clips to them without a word.
    pub limits_mm: [(f64, f64); 3],
    /// Whether it reads a stop while it waits inside a command, and says so.
    pub emergency_parser: bool,
    /// Whether M114 waits until the motion has ended, as old firmware does.
    pub position_waits: bool,
    /// Whether it knows M410.
    pub knows_stop: bool,
    /// Whether it refuses moves before homing.
    pub homes_first: bool,
    /// How long homing takes.
    pub homing_ms: u64,
    /// How often it says that it is busy.
    pub busy_every_ms: u64,
    /// Steps for a degree of A, 400 degrees each way, if it has that axis.
    pub steps_per_deg: Option<f64>,
    /// By how much it lifts Z before it homes another axis, mm, and whether R0 keeps it from that.
    pub lifts_mm: f64,
    /// Whether it knows R0.
    pub knows_r0: bool,
}

impl EmulatedBoard {
    /// A board of 400 steps per millimetre and 100 mm of travel.
    pub fn new() -> Self {
        Self {
            steps_per_mm: [400.0; 3],
            limits_mm: [(-100.0, 100.0); 3],
            emergency_parser: true,
            position_waits: false,
            knows_stop: true,
            homes_first: false,
            homing_ms: 200,
            busy_every_ms: 50,
            steps_per_deg: None,
            lifts_mm: 0.0,
            knows_r0: true,
        }
    }
}

impl Default for EmulatedBoard {
    fn default() -> Self {
        Self::new()
    }
}

/// The emulated board on its port.
pub type GcodeEmulator = Server<Board>;

impl GcodeEmulator {
    /// Starts it on a free port of 127.0.0.1.
    ///
    /// # Errors
    /// What the system says when there is no port.
    pub fn serve(board: EmulatedBoard) -> std::io::Result<Self> {
        Server::start(Board {
            board,
            from: [0.0; 4],
            goal: [0.0; 4],
            began: Instant::now(),
            takes: Duration::ZERO,
            feed_mm_per_s: 10.0,
            relative: true,
            last_number: None,
            line: Vec::new(),
            queue: VecDeque::new(),
            waits: None,
            said_busy: Instant::now(),
            damage: 0,
            deaf: false,
            takes_along: 0.0,
            says: Vec::new(),
            words: None,
            heard: Vec::new(),
        })
    }

    /// Where it really is, mm, whatever it says.
    pub fn truth(&self) -> [f64; 3] {
        let [x, y, z, _] = self.device().place();
        [x, y, z]
    }
    /// Where the turning axis really is, deg.
    pub fn turned_deg(&self) -> f64 {
        self.device().place()[3]
    }
    /// Whether it really moves.
    pub fn moves(&self) -> bool {
        self.device().moves()
    }
    /// Damages so many of the numbered lines that come next.
    pub fn damage_lines(&self, lines: u32) {
        self.device().damage = lines;
    }
    /// Makes it pass over stops.
    pub fn ignore_stops(&self) {
        self.device().deaf = true;
    }
    /// From now on every move of the first axis takes the third along by so much, mm, which the device says; 0 ends it.
    pub fn take_along(&self, mm: f64) {
        self.device().takes_along = mm;
    }
    /// Makes it say a line of its own accord.
    pub fn say(&self, line: &str) {
        self.device().says.extend(format!("{line}\n").bytes());
    }
    /// From now on every line that it says goes out as this makes it, for other firmware and bad wires.
    pub fn say_as(&self, words: impl FnMut(&str) -> Vec<u8> + Send + 'static) {
        self.device().words = Some(Box::new(words));
    }
    /// Stands still as if it had met an obstacle.
    pub fn block(&self) {
        self.device().stand();
    }
    /// The commands it obeyed or refused, without numbers and checksums.
    pub fn heard(&self) -> Vec<String> {
        self.device().heard.clone()
    }
}

/// What becomes of a line on its way out, its end included.
type Words = Box<dyn FnMut(&str) -> Vec<u8> + Send>;

/// What the board waits for before it goes on with its queue.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Waits {
    Motion {
        reports: bool,
    },
    Homing {
        until: Instant,
        axes: [bool; 4],
        lift_mm: f64,
    },
}

/// The state of the emulated board.
pub struct Board {
    board: EmulatedBoard,
    from: [f64; 4],
    goal: [f64; 4],
    began: Instant,
    takes: Duration,
    feed_mm_per_s: f64,
    relative: bool,
    last_number: Option<i64>,
    line: Vec<u8>,
    queue: VecDeque<String>,
    waits: Option<Waits>,
    said_busy: Instant,
    damage: u32,
    deaf: bool,
    takes_along: f64,
    says: Vec<u8>,
    words: Option<Words>,
    heard: Vec<String>,
}

impl Board {
    fn place(&self) -> [f64; 4] {
        let part = if self.takes.is_zero() {
            1.0
        } else {
            (self.began.elapsed().as_secs_f64() / self.takes.as_secs_f64()).min(1.0)
        };
        [0, 1, 2, 3].map(|i| self.from[i] + part * (self.goal[i] - self.from[i]))
    }

    fn moves(&self) -> bool {
        self.began.elapsed() < self.takes
    }

    fn stand(&mut self) {
        let place = self.place();
        (self.from, self.goal, self.takes) = (place, place, Duration::ZERO);
    }

    fn stop(&mut self) {
        if self.deaf {
            return;
        }
        self.stand();
        if matches!(self.waits, Some(Waits::Homing { .. })) {
            self.waits = Some(Waits::Motion { reports: false });
        }
    }

    fn report(&self, says: &mut Vec<u8>) {
        let place = self.place();
        let steps = [0, 1, 2].map(|i| (place[i] * self.board.steps_per_mm[i]).round() as i64);
        let [x, y, z, a] = self.goal;
        let (turned, counted) = match self.board.steps_per_deg {
            Some(per_deg) => (
                format!(" A:{a:.2}"),
                format!(" A:{}", (place[3] * per_deg).round() as i64),
            ),
            None => Default::default(),
        };
        let text = format!(
            "X:{x:.2} Y:{y:.2} Z:{z:.2}{turned} E:0.00 Count X:{} Y:{} Z:{}{counted}\n",
            steps[0], steps[1], steps[2]
        );
        says.extend(text.bytes());
    }

    /// The command of a line whose number and sum are right; else asks for it again.
    fn open(&mut self, line: &str, says: &mut Vec<u8>) -> Option<String> {
        let Some(rest) = line.strip_prefix('N') else {
            return Some(line.to_string());
        };
        let (body, sum) = line.rsplit_once('*')?;
        let (number, _) = rest.split_once(' ')?;
        let number: i64 = number.parse().ok()?;
        let (_, text) = body.split_once(' ')?;
        let mut right = body.bytes().fold(0, |s, b| s ^ b).to_string() == sum;
        if self.damage > 0 {
            self.damage -= 1;
            right = false;
        }
        let last = self.last_number.unwrap_or(-1);
        let restarts = text.starts_with("M110");
        if right && (restarts || number == last + 1) {
            self.last_number = Some(number);
            return Some(text.to_string());
        }
        let why = if right {
            "Line Number is not Last Line Number+1"
        } else {
            "checksum mismatch"
        };
        let text = format!("Error:{why}, Last Line: {last}\nResend: {}\nok\n", last + 1);
        says.extend(text.bytes());
        None
    }

    fn obey(&mut self, command: &str, says: &mut Vec<u8>) {
        self.heard.push(command.to_string());
        let mut words = command.split_ascii_whitespace();
        let name = words.next().unwrap_or("");
        match name {
            "M110" | "G21" => {}
            "G90" => self.relative = false,
            "M115" => {
                let can = u8::from(self.board.emergency_parser);
                let text = format!(
                    "FIRMWARE_NAME:Marlin 2.1 (emulated) SOURCE_CODE_URL:none\nCap:EMERGENCY_PARSER:{can}\n"
                );
                says.extend(text.bytes());
            }
            "M410" if self.board.knows_stop => self.stop(),
            "M400" => self.waits = Some(Waits::Motion { reports: false }),
            "M114" if self.board.position_waits => {
                self.waits = Some(Waits::Motion { reports: true });
            }
            "M114" => self.report(says),
            "G28" => {
                let wait = Duration::from_millis(self.board.homing_ms);
                let (options, named): (Vec<&str>, Vec<&str>) =
                    words.partition(|w| w.starts_with('R'));
                let axes = ["X", "Y", "Z", "A"].map(|a| named.is_empty() || named.contains(&a));
                let keeps = self.board.knows_r0 && options.contains(&"R0");
                self.waits = Some(Waits::Homing {
                    until: Instant::now() + wait,
                    axes,
                    lift_mm: if keeps { 0.0 } else { self.board.lifts_mm },
                });
            }
            "G1" => self.go(words, says),
            _ => says.extend(format!("echo:Unknown command: \"{command}\"\n").bytes()),
        }
        self.said_busy = Instant::now();
        if self.waits.is_none() {
            says.extend(b"ok\n");
        }
    }

    fn go<'a>(&mut self, words: impl Iterator<Item = &'a str>, says: &mut Vec<u8>) {
        if self.board.homes_first {
            says.extend(b"echo:Home XYZ First\n");
            return;
        }
        let from = self.place();
        let mut goal = self.goal;
        for word in words {
            let (Some(letter), Some(value)) = (word.get(..1), word.get(1..)) else {
                continue;
            };
            let Ok(value) = value.parse::<f64>() else {
                continue;
            };
            let at = match letter {
                "X" => 0,
                "Y" => 1,
                "Z" => 2,
                "A" if self.board.steps_per_deg.is_some() => 3,
                "F" => {
                    self.feed_mm_per_s = value / 60.0;
                    continue;
                }
                _ => continue,
            };
            let limits = self.board.limits_mm.get(at);
            let (low, high) = limits.copied().unwrap_or((-400.0, 400.0));
            let to = if self.relative {
                goal[at] + value
            } else {
                value
            };
            goal[at] = to.clamp(low, high);
        }
        if goal[0] != from[0] {
            goal[2] += self.takes_along;
        }
        let way: f64 = [0, 1, 2, 3]
            .map(|i| (goal[i] - from[i]).powi(2))
            .iter()
            .sum();
        self.takes = Duration::from_secs_f64(way.sqrt() / self.feed_mm_per_s);
        self.began = Instant::now();
        (self.from, self.goal) = (from, goal);
    }
}

impl Device for Board {
    fn hear(&mut self, byte: u8, says: &mut Vec<u8>) {
        let mut plain = Vec::new();
        self.take(byte, &mut plain);
        self.send(&plain, says);
    }

    fn tick(&mut self, says: &mut Vec<u8>) {
        let mut plain = Vec::new();
        self.go_on(&mut plain);
        self.send(&plain, says);
    }
}

impl Board {
    fn send(&mut self, plain: &[u8], says: &mut Vec<u8>) {
        let Some(words) = &mut self.words else {
            return says.extend(plain);
        };
        for line in String::from_utf8_lossy(plain).lines() {
            says.extend(words(line));
        }
    }

    fn take(&mut self, byte: u8, says: &mut Vec<u8>) {
        if byte != b'\n' {
            self.line.push(byte);
            return;
        }
        let line = String::from_utf8_lossy(&self.line).into_owned();
        self.line.clear();
        let Some(command) = self.open(&line, says) else {
            return;
        };
        let waits = self.waits.is_some();
        if command == "M410" && self.board.knows_stop && (self.board.emergency_parser || !waits) {
            self.stop();
        }
        self.queue.push_back(command);
        self.go_on(says);
    }

    fn go_on(&mut self, says: &mut Vec<u8>) {
        says.append(&mut self.says);
        loop {
            match self.waits {
                Some(Waits::Motion { .. }) if self.moves() => break,
                Some(Waits::Homing { until, .. }) if Instant::now() < until => break,
                Some(waits) => {
                    match waits {
                        Waits::Homing { axes, lift_mm, .. } => {
                            self.stand();
                            self.from[2] += lift_mm;
                            self.goal[2] += lift_mm;
                            for (at, _) in axes.iter().enumerate().filter(|(_, homed)| **homed) {
                                (self.from[at], self.goal[at]) = (0.0, 0.0);
                            }
                            self.board.homes_first = false;
                        }
                        Waits::Motion { reports: true } => self.report(says),
                        Waits::Motion { reports: false } => {}
                    }
                    self.waits = None;
                    says.extend(b"ok\n");
                }
                None => match self.queue.pop_front() {
                    Some(command) => self.obey(&command, says),
                    None => return,
                },
            }
        }
        let every = Duration::from_millis(self.board.busy_every_ms);
        if self.said_busy.elapsed() > every {
            self.said_busy = Instant::now();
            says.extend(b"echo:busy: processing\n");
        }
    }
}
