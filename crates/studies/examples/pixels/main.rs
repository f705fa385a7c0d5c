//! Pixels as a measurement and as evidence: what the refinement makes of a registration, and what blocks of pixels say of transforms that
//! are right and wrong.
//!
//! `cargo run --release -p scopeservo-studies --example pixels -- refine|null|right|time [PAIRS]`
//!
//! The large specimens of `SCOPESERVO_SPECIMENS` are used. Images are rendered from them by code of the study.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

mod disturb;
mod judge;
mod refined;

use scopeservo_slide::Slide;
use scopeservo_studies::specimens;
use scopeservo_studies::warp::Source;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let mode = std::env::args()
        .nth(1)
        .ok_or("say refine, null, right or time")?;
    let pairs: u64 = std::env::args().nth(2).map_or(Ok(20), |a| a.parse())?;
    match mode.as_str() {
        "refine" => refined::table(pairs),
        "time" => refined::time(pairs),
        "null" => judge::wrong(pairs),
        "right" => judge::right(pairs),
        other => Err(format!("no table is called {other}").into()),
    }
}

/// A specimen by the name of its file.
fn source(name: &str) -> Outcome<Source> {
    let folder = specimens().ok_or("set SCOPESERVO_SPECIMENS to the folder of slides")?;
    let gray = Slide::open(&folder.join(name))?.read_gray(0)?;
    let source = Source {
        width: gray.width,
        height: gray.height,
        data: gray.data,
    };
    Ok(source.landscape())
}

/// The specimens that are large enough for each of the views.
const LARGE: [&str; 3] = [
    "carcinoma_he.png",
    "embryo_section.png",
    "cytology_scanner_a.tif",
];
