//! Drivers that are killed, that hang, and what they leave behind.

use super::*;

#[cfg(unix)]
#[test]
fn a_driver_that_is_killed_is_noticed_and_one_that_hangs_is_ended() {
    let script = |then: &str| {
        let hello = HELLO.trim_end();
        vec![
            "-c".to_owned(),
            format!("read line; echo '{hello}'; {then}"),
        ]
    };
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let killed = Driver::spawn("sh", &script("read line; kill -9 $$")).unwrap();
    let stage = killed.devices(&clock).unwrap().stage.unwrap();
    let error = stage.position().unwrap_err();
    assert!(error.to_string().contains("it ended"), "{error}");

    // It tells its number, then neither reads nor ends by itself.
    let folder = std::env::temp_dir().join(format!("scopeservo-hangs-{}", std::process::id()));
    let hangs = format!(
        "echo $$ > '{}'; while :; do sleep 1; done",
        folder.display()
    );
    let driver = Driver::spawn("sh", &script(&hangs)).unwrap();
    let mut number = String::new();
    while !number.ends_with('\n') {
        std::thread::sleep(Duration::from_millis(10));
        number = std::fs::read_to_string(&folder).unwrap_or_default();
    }
    drop(driver);
    std::fs::remove_file(&folder).unwrap();
    assert!(!runs(number.trim()), "{number} still runs");
}

/// A program that says hello, and whatever `then` does after that, in its own folder.
#[cfg(unix)]
fn program(folder: &std::path::Path, then: &str) -> Driver {
    let hello = HELLO.trim_end();
    let script = format!(
        "cd '{}'; read line; echo '{hello}'; {then}",
        folder.display()
    );
    Driver::spawn("sh", &["-c".to_owned(), script]).unwrap()
}

/// A folder of a test's own.
#[cfg(unix)]
struct Folder(std::path::PathBuf);

#[cfg(unix)]
impl Folder {
    fn new(name: &str) -> Self {
        let name = format!("scopeservo-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
    fn read(&self, file: &str) -> String {
        std::fs::read_to_string(self.0.join(file)).unwrap_or_default()
    }
}

#[cfg(unix)]
impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[cfg(unix)]
#[test]
fn the_answer_to_bye_is_waited_for() {
    let folder = Folder::new("bye");
    // Slow to answer, or with more than a pipe holds; it would die of what nobody reads, and then not write its last word.
    for (k, answer) in [
        "echo '{\"id\":3,\"ok\":true}'",
        "sleep 0.3; echo '{\"id\":3,\"ok\":true}'",
        "head -c 300000 /dev/zero; sleep 0.1; echo '{\"id\":3,\"ok\":true}'",
    ]
    .into_iter()
    .enumerate()
    {
        let file = format!("said{k}");
        let then = format!(
            "read stop; echo '{{\"id\":2,\"ok\":true}}'; read bye; ({answer}) && echo \"$bye\" > {file}"
        );
        drop(program(&folder.0, &then));
        let said = folder.read(&file);
        assert!(said.contains("\"call\":\"bye\""), "{answer}: {said:?}");
    }
    // And of one that listens on a port: it may say all that it has to say.
    for more in ["", " ", "\n"] {
        static MORE: std::sync::Mutex<&str> = std::sync::Mutex::new("");
        static SAID: std::sync::Mutex<Option<bool>> = std::sync::Mutex::new(None);
        *MORE.lock().unwrap() = more;
        *SAID.lock().unwrap() = None;
        let (address, told) = peer(HELLO, |line, stream| {
            if line.contains("bye") {
                std::thread::sleep(Duration::from_millis(100));
            }
            let more = MORE.lock().unwrap();
            let wrote = writeln!(stream, "{{\"id\":{},\"ok\":true{more}}}", id(line))
                .and_then(|()| stream.write_all(&[b' '; 300_000]));
            if line.contains("bye") {
                *SAID.lock().unwrap() = Some(wrote.is_ok());
            }
            Ok(!line.contains("bye"))
        });
        drop(Driver::connect(&address, None).unwrap());
        let last = told.iter().last().unwrap();
        assert!(last.contains("bye"), "{last}");
        assert_eq!(*SAID.lock().unwrap(), Some(true));
    }
}

/// Whether a process runs; one that has ended and that nobody has asked about yet does not.
#[cfg(unix)]
fn runs(number: &str) -> bool {
    let asked = std::process::Command::new("kill")
        .args(["-0", number])
        .output();
    let state = std::fs::read_to_string(format!("/proc/{number}/stat")).unwrap_or_default();
    asked.unwrap().status.success() && !state.contains(") Z ")
}

#[cfg(unix)]
#[test]
fn what_a_driver_started_ends_with_it() {
    let folder = Folder::new("children");
    let alive = |numbers: &str| -> (usize, usize) {
        let all: Vec<&str> = numbers.split_whitespace().collect();
        (all.len(), all.iter().filter(|n| runs(n)).count())
    };
    for (name, then) in [
        // It ends as it should, and leaves three behind.
        (
            "honest",
            "for i in 1 2 3; do sleep 60 & echo $! >> honest; done; cat > /dev/null",
        ),
        // It crashes, and leaves one that holds its output.
        ("crash", "sleep 60 & echo $! > crash; kill -9 $$"),
        // What it leaves does not listen to a request to end.
        (
            "deaf",
            "sh -c 'trap \"\" TERM; while :; do sleep 0.1; done' & echo $! > deaf; cat > /dev/null",
        ),
    ] {
        let driver = program(&folder.0, then);
        let start = Instant::now();
        while folder.read(name).is_empty() {
            assert!(start.elapsed() < Duration::from_secs(60));
            std::thread::sleep(Duration::from_millis(10));
        }
        drop(driver);
        let numbers = folder.read(name);
        let start = Instant::now();
        while alive(&numbers).1 > 0 {
            assert!(start.elapsed() < Duration::from_secs(20), "{name}");
            std::thread::sleep(Duration::from_millis(10));
        }
        assert!(alive(&numbers).0 > 0, "{name}");
    }
}
