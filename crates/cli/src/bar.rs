//! What is drawn of work under way, below the lines that are told.

use console::Term;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::sync::OnceLock;
use std::time::Duration;

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

/// Work of so many parts.
pub(crate) fn of(parts: u64) -> ProgressBar {
    let (_, columns) = Term::stderr().size();
    steady(ProgressBar::new(parts), template(columns))
}

/// Work of parts of which it is told how many there are while it is done; nothing is shown of work that is done at once.
pub(crate) struct Parts {
    what: &'static str,
    bar: std::cell::OnceCell<ProgressBar>,
}

impl Parts {
    pub(crate) fn new(what: &'static str) -> Self {
        Self {
            what,
            bar: std::cell::OnceCell::new(),
        }
    }

    /// So many of so many are done.
    pub(crate) fn done(&self, done: usize, all: usize) {
        let bar = self.bar.get_or_init(|| {
            let bar = of(all as u64);
            bar.set_message(self.what);
            bar
        });
        bar.set_position(done as u64);
    }
}

impl Drop for Parts {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.get() {
            bar.finish_and_clear();
        }
    }
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
