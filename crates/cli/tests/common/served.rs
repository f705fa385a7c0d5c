//! A driver on a port of its own for as long as a test runs. It stays as it is when a program that drives it ends.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

/// The driver, ended with the test.
pub struct Served {
    child: Child,
    pub address: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The simulated microscope. It says where it listens.
pub fn serve_twin(folder: &Path, args: &[&str]) -> Served {
    let program = Path::new(env!("CARGO_BIN_EXE_scopeservo"));
    let args = [&["twin", "serve"], args].concat();
    let (child, said) = listening(program, &args, folder, "127.0.0.1:0");
    let address = said.split("listens on ").nth(1).expect("an address");
    let address = address.split(';').next().unwrap().to_owned();
    Served { child, address }
}

/// A program that takes `--listen` and an address, and says when it does.
pub fn serve(program: &Path, args: &[&str], folder: &Path) -> Served {
    let address = format!("127.0.0.1:{}", free_port());
    let (child, _) = listening(program, args, folder, &address);
    Served { child, address }
}

/// A port that nobody listens on, for a program that does not choose one itself.
pub fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.local_addr().unwrap().port()
}

/// The program, and the line that says that it listens.
fn listening(program: &Path, args: &[&str], folder: &Path, address: &str) -> (Child, String) {
    let mut child = Command::new(program)
        .current_dir(folder)
        .args(args)
        .args(["--listen", address])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("listen") {
        line.clear();
        assert!(
            said.read_line(&mut line).unwrap() > 0,
            "{args:?} ended before it listened"
        );
    }
    // What it says later must not fill the pipe.
    std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
    (child, line)
}
