//! Thirty whole runs: procedural tissue and five real slides, five seeds each.
//!
//! `cargo build --release && cargo run --release -p scopeservo-studies --example arrivals -- [SEEDS] [FIRST_SEED]`
//!
//! Runs the program itself, reads its JSON, and prints a line per run. Exit code 1 when a run did not arrive within
//! 1.0 um and 0.02 deg of the truth.

#![expect(clippy::print_stdout, reason = "a study prints its table")]

use scopeservo_studies::specimens;
use std::process::Command;

/// Files and, where they do not state it, um per pixel.
const SLIDES: [(&str, &str); 5] = [
    ("carcinoma_he.png", "0.5"),
    ("skin_he.svs", "0.499"),
    ("liver_he.jpg", "0.49"),
    ("liver_sirius_red.jpg", "0.49"),
    ("embryo_section.png", "0.258"),
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let seeds: u64 = args.next().map_or(Ok(5), |a| a.parse())?;
    let first: u64 = args.next().map_or(Ok(1), |a| a.parse())?;
    let program = std::env::current_exe()?
        .parent()
        .and_then(|p| p.parent())
        .ok_or("the study does not know where it lies")?
        .join(format!("scopeservo{}", std::env::consts::EXE_SUFFIX));
    let folder = specimens();
    let mut slides = vec![(None, "")];
    match &folder {
        Some(folder) => slides.extend(SLIDES.map(|(f, um)| (Some(folder.join(f)), um))),
        None => println!("skipped: the real slides, since SCOPESERVO_SPECIMENS is not set"),
    }
    println!(
        "specimen seed verdict true_um true_deg claimed_um moves frames virtual_s wall_s iterations inliers"
    );
    let (mut runs, mut good, mut worst_um, mut worst_deg) = (0, 0, 0.0f64, 0.0f64);
    for (path, um) in &slides {
        for seed in first..first + seeds {
            let mut command = Command::new(&program);
            command.args(["demo", "--json", "--seed", &seed.to_string()]);
            if let Some(path) = path {
                command
                    .arg("--specimen")
                    .arg(path)
                    .args(["--um-per-px", um]);
            }
            let scratch =
                std::env::temp_dir().join(format!("scopeservo-arrivals-{}", std::process::id()));
            std::fs::create_dir_all(&scratch)?;
            let started = std::time::Instant::now();
            let output = command.current_dir(&scratch).output()?;
            let wall = started.elapsed().as_secs_f64();
            let name = path.as_ref().map_or("tissue".into(), |p| {
                p.file_name()
                    .unwrap_or_default()
                    .to_string_lossy()
                    .into_owned()
            });
            runs += 1;
            let Ok(answer) = serde_json::from_slice::<serde_json::Value>(&output.stdout) else {
                println!(
                    "{name} {seed} FAULT {}",
                    String::from_utf8_lossy(&output.stderr).trim()
                );
                continue;
            };
            let number = |key: &str| answer[key].as_f64().unwrap_or(f64::NAN);
            let list = |key: &str| {
                let all = answer["magnifications"]
                    .as_array()
                    .cloned()
                    .unwrap_or_default();
                all.iter()
                    .map(|m| m[key].to_string())
                    .collect::<Vec<_>>()
                    .join("/")
            };
            let (error_um, error_deg) = (number("true_error_um"), number("true_error_deg"));
            let ok = answer["verdict"] == "arrived" && error_um <= 1.0 && error_deg <= 0.02;
            good += usize::from(ok);
            worst_um = worst_um.max(error_um);
            worst_deg = worst_deg.max(error_deg);
            println!(
                "{name} {seed} {} {error_um:.3} {error_deg:.4} {:.3} {} {} {:.1} {wall:.1} {} {}{}",
                answer["verdict"].as_str().unwrap_or("?"),
                number("estimated_error_um"),
                answer["moves"],
                answer["frames"],
                number("virtual_time_s"),
                list("iterations"),
                list("inliers"),
                if ok {
                    String::new()
                } else {
                    format!(" MISSED: {}", answer["message"])
                }
            );
        }
    }
    println!(
        "{good} of {runs} arrived within 1.0 um and 0.02 deg; worst {worst_um:.3} um, {worst_deg:.4} deg"
    );
    if good < runs {
        std::process::exit(1);
    }
    Ok(())
}
