//! An emulated Sangaboard: three steppers counted in steps, moves that do not block, or old firmware that does.

use super::server::{Device, Server};
use std::time::{Duration, Instant};

/// What is emulated.
#[derive(Debug, Clone, PartialEq)]
pub struct EmulatedSanga {
    /// The least time of a step, us, which it keeps.
    pub step_us: f64,
    /// Whether it knows that time.
    pub knows_step_time: bool,
    /// Whether another step time counts for the move under way as well.
    pub changes_under_way: bool,
    /// Where it stands at the start.
    pub at_steps: [i32; 3],
    /// Whether the firmware knows stops and moves that do not block.
    pub knows_stop: bool,
    /// Whether moves block at the start.
    pub blocks: bool,
    /// Whether it says its version when somebody connects, as a board does that starts then.
    pub greets_after_ms: Option<u64>,
}

impl EmulatedSanga {
    /// A board with new firmware and 4000 steps a second.
    pub fn new() -> Self {
        Self {
            step_us: 250.0,
            knows_step_time: true,
            changes_under_way: false,
            at_steps: [0; 3],
            knows_stop: true,
            blocks: true,
            greets_after_ms: None,
        }
    }
}

impl Default for EmulatedSanga {
    fn default() -> Self {
        Self::new()
    }
}

/// The emulated board on its port.
pub type SangaEmulator = Server<Sanga>;

impl SangaEmulator {
    /// Starts it on a free port of 127.0.0.1.
    ///
    /// # Errors
    /// What the system says when there is no port.
    pub fn serve(board: EmulatedSanga) -> std::io::Result<Self> {
        Server::start(Sanga {
            from: board.at_steps,
            goal: board.at_steps,
            began: Instant::now(),
            takes: Duration::ZERO,
            greets: board
                .greets_after_ms
                .map(|ms| Instant::now() + Duration::from_millis(ms)),
            deaf: false,
            takes_along: 0,
            line: String::new(),
            heard: Vec::new(),
            board,
        })
    }

    /// Where it really is, steps.
    pub fn truth(&self) -> [i32; 3] {
        self.device().place()
    }
    /// Whether it really moves.
    pub fn moves(&self) -> bool {
        self.device().moves()
    }
    /// Makes it pass over stops, though it answers them.
    pub fn ignore_stops(&self) {
        self.device().deaf = true;
    }
    /// From now on every move of the first axis takes the third along by so much, steps, which the device says; 0 ends it.
    pub fn take_along(&self, steps: i32) {
        self.device().takes_along = steps;
    }
    /// Stands still as if an end switch had been met.
    pub fn block(&self) {
        self.device().stand();
    }
    /// The lines it heard.
    pub fn heard(&self) -> Vec<String> {
        self.device().heard.clone()
    }
}

/// The state of the emulated board.
pub struct Sanga {
    board: EmulatedSanga,
    from: [i32; 3],
    goal: [i32; 3],
    began: Instant,
    takes: Duration,
    greets: Option<Instant>,
    deaf: bool,
    takes_along: i32,
    line: String,
    heard: Vec<String>,
}

impl Sanga {
    fn moves(&self) -> bool {
        self.began.elapsed() < self.takes
    }

    fn place(&self) -> [i32; 3] {
        if !self.moves() {
            return self.goal;
        }
        let part = self.began.elapsed().as_secs_f64() / self.takes.as_secs_f64();
        [0, 1, 2].map(|i| {
            let way = f64::from(self.goal[i]) - f64::from(self.from[i]);
            self.from[i] + (part * way) as i32
        })
    }

    fn time_of(&self, steps: i32) -> Duration {
        Duration::from_secs_f64(1e-6 * f64::from(steps.abs()) * self.board.step_us.max(0.0))
    }

    fn stand(&mut self) {
        let place = self.place();
        (self.from, self.goal, self.takes) = (place, place, Duration::ZERO);
    }

    fn obey(&mut self, line: &str) -> String {
        let words: Vec<&str> = line.split(' ').collect();
        let new = self.board.knows_stop;
        match words[..] {
            ["version"] if new => "Sangaboard Firmware v1.0.1 (emulated)".into(),
            ["version"] => "Sangaboard Firmware v0.5.1 (emulated)".into(),
            ["p?"] => {
                let [x, y, z] = self.place();
                format!("{x} {y} {z}")
            }
            ["release"] => "done".into(),
            ["mr", x, y, z] => {
                let mut by = [x, y, z].map(|w| w.parse::<i32>().unwrap_or(0));
                if by[0] != 0 {
                    by[2] += self.takes_along;
                }
                self.from = self.place();
                self.goal = [0, 1, 2].map(|i| self.from[i] + by[i]);
                let most = by.iter().map(|b| b.abs()).max().unwrap_or(0);
                self.takes = self.time_of(most);
                self.began = Instant::now();
                "done.".into()
            }
            ["dt?"] if self.board.knows_step_time => {
                format!("minimum step delay {:.0}", self.board.step_us)
            }
            ["dt", us] if self.board.knows_step_time => {
                self.board.step_us = us.parse().unwrap_or(0.0);
                if self.board.changes_under_way && self.moves() {
                    let goal = self.goal;
                    self.stand();
                    self.goal = goal;
                    let way = [0, 1, 2].map(|i| (goal[i] - self.from[i]).abs());
                    self.takes = self.time_of(way.into_iter().max().unwrap_or(0));
                    self.began = Instant::now();
                }
                "done.".into()
            }
            ["blocking_moves?"] if new => format!("blocking_moves {}", self.board.blocks),
            ["blocking_moves", "false"] if new => {
                self.board.blocks = false;
                "done.".into()
            }
            ["moving?"] if new => self.moves().to_string(),
            ["stop"] if new => {
                if !self.deaf {
                    self.stand();
                }
                "Move aborted".into()
            }
            _ => "Type 'help' for a list of commands.".into(),
        }
    }
}

impl Device for Sanga {
    fn hear(&mut self, byte: u8, says: &mut Vec<u8>) {
        if byte != b'\n' {
            self.line.push(char::from(byte));
            return;
        }
        let line = std::mem::take(&mut self.line);
        let answer = self.obey(&line);
        self.heard.push(line);
        says.extend(format!("{answer}\r\n").bytes());
    }

    fn tick(&mut self, says: &mut Vec<u8>) {
        if self.greets.is_some_and(|at| at <= Instant::now()) {
            self.greets = None;
            says.extend(b"Sangaboard Firmware v1.0.1 (emulated)\r\n");
        }
    }
}
