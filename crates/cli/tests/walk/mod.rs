//! README.md's walk-through: its commands, what they say there, its picture and the figures under it.

use crate::Reader;
use crate::common::page::{Fence, fences, page};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{self, FilterType};
use image::{ExtendedColorType, Rgb, RgbImage};
use scopeservo_scope::{deg_in_words, um_in_words};
use std::fs;
use std::path::Path;

const PICTURE: &str = "docs/images/walk-through.jpg";
/// The line after it is made of what was measured.
const FIGURES: &str = "<!-- figures of the walk-through -->";
/// Of a view in the picture, pixels.
const VIEW: [u32; 2] = [320, 240];
const GAP: u32 = 8;

/// Runs all blocks of README.md, and compares what it says of them.
pub(crate) fn through(reader: &Reader) {
    let text = page("README.md");
    let mut now = text.clone();
    let mut said: Vec<String> = Vec::new();
    for Fence { info, body } in fences(&text) {
        match &*info {
            "sh" => said = reader.done("README.md", &body),
            "sh device" | "sh install" | "sh ci" => {
                println!("README.md: left out ({info}):\n{body}")
            }
            "text" => now = now.replacen(&body, &renewed(&body, &said), 1),
            _ => panic!("README.md: say what this needs:\n{body}"),
        }
    }
    let before = line_after(&text, FIGURES);
    now = now.replacen(before, &figures(reader), 1);
    let picture = picture(&fs::read_to_string(reader.path("ladder/report.html")).unwrap());
    if std::env::var("SCOPESERVO_PAGES").is_ok_and(|v| v == "write") {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        fs::write(root.join("README.md"), now).unwrap();
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, 80)
            .encode(
                &picture,
                picture.width(),
                picture.height(),
                ExtendedColorType::Rgb8,
            )
            .unwrap();
        assert!(jpeg.len() < 150_000, "{} bytes are too many", jpeg.len());
        fs::create_dir_all(root.join("docs/images")).unwrap();
        fs::write(root.join(PICTURE), jpeg).unwrap();
        return;
    }
    for (stands, comes) in text.lines().zip(now.lines()) {
        assert!(
            agree(stands, comes),
            "README.md says\n{stands}\nand it is\n{comes}\n(SCOPESERVO_PAGES=write writes it anew)"
        );
    }
    let kept = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(PICTURE);
    let kept = image::open(kept).unwrap().to_rgb8();
    assert_eq!(kept.dimensions(), picture.dimensions());
    let mean = mean_off(&kept, &picture);
    assert!(
        mean < 6.0,
        "{PICTURE} is another than the walk-through gives: {mean} grey levels off"
    );
}

/// How far two images are off from each other on average, grey levels.
fn mean_off(a: &RgbImage, b: &RgbImage) -> f64 {
    let each = a.as_raw().iter().zip(b.as_raw());
    let sum: f64 = each.map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
    sum / a.as_raw().len() as f64
}

fn line_after<'a>(text: &'a str, mark: &str) -> &'a str {
    let (_, rest) = text.split_once(mark).expect("the mark is there");
    rest.trim_start_matches('\n')
        .lines()
        .next()
        .unwrap_or_default()
}

/// The lines of a block as they were said, each found by its words.
fn renewed(block: &str, said: &[String]) -> String {
    let mut said = said.iter();
    let lines = block.lines().map(|line| {
        let found = said.find(|s| words(s) == words(line));
        format!(
            "{}\n",
            found.unwrap_or_else(|| panic!("nothing said\n{line}"))
        )
    });
    lines.collect()
}

/// A line without its numbers.
fn words(line: &str) -> String {
    pieces(line)
        .into_iter()
        .map(|p| p.unwrap_or_else(|_| "#".into()))
        .collect()
}

/// Words, and in their places numbers.
fn pieces(line: &str) -> Vec<Result<String, f64>> {
    let mut all: Vec<Result<String, f64>> = Vec::new();
    let is_number = |c: char| c.is_ascii_digit() || c == '.';
    // Whether an amount rounds to nothing is chance, too.
    let line = line.replace("less than ", "");
    let mut rest = &*line;
    while !rest.is_empty() {
        let begins = rest
            .find(|c: char| c.is_ascii_digit())
            .unwrap_or(rest.len());
        if begins > 0 {
            // Blanks before a number depend on how long it is, a sign on chance.
            let blank = rest[..begins].trim_end_matches(['-', ' ']);
            all.push(Ok(blank.into()));
        }
        rest = &rest[begins..];
        let ends = rest.find(|c| !is_number(c)).unwrap_or(rest.len());
        let (number, after) = rest.split_at(ends);
        if !number.is_empty() {
            let number = number.trim_end_matches('.');
            all.push(number.parse().map_or_else(|_| Ok(number.into()), Err));
        }
        rest = after;
    }
    all
}

/// Whether two lines have the same words, and numbers that differ by no more than the arithmetic of another processor may make them.
fn agree(a: &str, b: &str) -> bool {
    let (a, b) = (pieces(a), pieces(b));
    let same = |pair: (&Result<String, f64>, &Result<String, f64>)| match pair {
        (Ok(a), Ok(b)) => a == b,
        (Err(a), Err(b)) => (a - b).abs() <= 0.02 + 0.25 * a.abs().max(b.abs()),
        _ => false,
    };
    a.len() == b.len() && a.iter().zip(&b).all(same)
}

/// The sentence under the picture.
fn figures(reader: &Reader) -> String {
    let moved = fs::read_to_string(reader.path("moved.toml")).unwrap();
    let value = |key: &str| {
        let line = moved.lines().find_map(|l| l.strip_prefix(key)).unwrap();
        let line = line.split('#').next().unwrap();
        let numbers = line.split(|c: char| !(c.is_ascii_digit() || ".-".contains(c)));
        numbers.filter_map(|n| n.parse().ok()).collect::<Vec<f64>>()
    };
    let shift = value("centre_um = ");
    let result: serde_json::Value =
        serde_json::from_str(&fs::read_to_string(reader.path("ladder/result.json")).unwrap())
            .unwrap();
    assert_eq!(result["verdict"], "arrived");
    format!(
        "*Saved at 40x; the slide put back {:.0} um beside and turned by {:.0} degrees, as 10x sees it; 20x on the way; 40x at the end, {} and {} off. \
         The frame is the saved view as it was recognised.*",
        f64::hypot(shift[0], shift[1]),
        value("turned_deg = ")[0],
        um_in_words(result["estimated_error_um"].as_f64().unwrap(), 2),
        deg_in_words(result["estimated_error_deg"].as_f64().unwrap().abs(), 4),
    )
}

/// The saved view, and those of the way back with the saved view's outline, side by side.
fn picture(report: &str) -> RgbImage {
    let views = ["10x, iteration 0", "20x, iteration 0", "40x, iteration"];
    let mut all = vec![(embedded(report, "target"), None)];
    for (k, label) in views.iter().enumerate() {
        let label = format!("aria-label=\"View at {label}");
        let with = report
            .split("<svg class=\"pic\"")
            .filter(|svg| svg.split('>').next().unwrap().contains(&label));
        let with: Vec<&str> = with.collect();
        // At the end the last one.
        let svg = if k == 2 { with.last() } else { with.first() }.unwrap();
        let name = between(svg, "href=\"#", "\"").unwrap();
        all.push((
            embedded(report, name),
            between(svg, "class=\"outline\" d=\"", "\"").map(corners),
        ));
    }
    // At the end it is the saved view that is seen.
    let off = |k: usize| mean_off(&all[0].0, &all[k].0);
    assert!(off(3) < 8.0 && off(1) > 20.0, "{} {}", off(3), off(1));
    let width = all.len() as u32 * (VIEW[0] + GAP) - GAP;
    let mut strip = RgbImage::from_pixel(width, VIEW[1], Rgb([255; 3]));
    for (k, (view, outline)) in all.into_iter().enumerate() {
        let scale = f64::from(VIEW[0]) / f64::from(view.width());
        let mut small = imageops::resize(&view, VIEW[0], VIEW[1], FilterType::Triangle);
        if let Some(corners) = outline.filter(|_| k < 3) {
            draw(
                &mut small,
                &corners.map(|p| p.map(|v| scale * (v + 0.5) - 0.5)),
            );
        }
        imageops::replace(&mut strip, &small, i64::from(k as u32 * (VIEW[0] + GAP)), 0);
    }
    strip
}

fn between<'a>(text: &'a str, from: &str, to: &str) -> Option<&'a str> {
    Some(text.split_once(from)?.1.split_once(to)?.0)
}

fn embedded(report: &str, name: &str) -> RgbImage {
    let image = report
        .split_once(&format!("<image id=\"{name}\""))
        .unwrap()
        .1;
    let data = between(image, "base64,", "\"").unwrap();
    image::load_from_memory(&STANDARD.decode(data).unwrap())
        .unwrap()
        .to_rgb8()
}

/// The corners of `M x yL x yL x yL x yZ`.
fn corners(path: &str) -> [[f64; 2]; 4] {
    let numbers: Vec<f64> = path
        .split(['M', 'L', 'Z', ' '])
        .filter_map(|n| n.parse().ok())
        .collect();
    std::array::from_fn(|k| [numbers[2 * k], numbers[2 * k + 1]])
}

/// A closed line of four corners, yellow between dark.
fn draw(image: &mut RgbImage, corners: &[[f64; 2]; 4]) {
    for (half, colour) in [(2.2, [30, 30, 30]), (1.1, [255, 220, 0])] {
        for k in 0..4 {
            let (a, b) = (corners[k], corners[(k + 1) % 4]);
            let length = f64::hypot(b[0] - a[0], b[1] - a[1]);
            for (x, y, pixel) in image.enumerate_pixels_mut() {
                let p = [f64::from(x) - a[0], f64::from(y) - a[1]];
                let along = (p[0] * (b[0] - a[0]) + p[1] * (b[1] - a[1])) / length;
                let near = along.clamp(0.0, length) / length;
                let off = f64::hypot(p[0] - near * (b[0] - a[0]), p[1] - near * (b[1] - a[1]));
                if off <= half {
                    *pixel = Rgb(colour);
                }
            }
        }
    }
}
