//! Writes a report of a made-up run: `cargo run -p scopeservo-report --example sample -- FILE [not-found | no-focus]`.

#[path = "../tests/synthetic/mod.rs"]
mod synthetic;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let file = arguments
        .next()
        .ok_or("give the name of the file to write")?;
    let run = match arguments.next().as_deref() {
        None => synthetic::arrived(),
        Some("not-found") => synthetic::not_found(),
        Some("no-focus") => synthetic::no_focus(),
        Some(other) => return Err(format!("there is no sample called {other}").into()),
    };
    let truth = run
        .recorder
        .events()
        .iter()
        .any(|e| matches!(&e.event, scopeservo_servo::Event::Iteration { .. }));
    let page = scopeservo_report::html(
        &run.recorder,
        truth.then_some(&run.truth),
        &synthetic::context(),
    );
    std::fs::write(file, page)?;
    Ok(())
}
