//! Images: kept as they came or compressed, and embedded once each.

use crate::svg::{Attr, nice_step};
use crate::text::{escape, fixed};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage, imageops};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::Arc;

/// Longer images are shown smaller than they came: a page for a phone.
const LONGEST_SIDE_PX: u32 = 1024;
const QUALITY: u8 = 85;

/// 8-bit RGB, row-major. Cheap to clone.
#[derive(Debug, Clone)]
pub(crate) struct Picture {
    pub(crate) width: usize,
    pub(crate) height: usize,
    rgb: Arc<[u8]>,
}

/// A compressed image, with the size that it had before.
#[derive(Debug, Clone)]
pub(crate) struct Jpeg {
    pub(crate) width: usize,
    pub(crate) height: usize,
    bytes: Arc<[u8]>,
}

impl Picture {
    /// `None` when the length does not fit the size, or there is nothing to see.
    pub(crate) fn new(width: usize, height: usize, rgb: Vec<u8>) -> Option<Self> {
        (!rgb.is_empty() && rgb.len() == width * height * 3).then(|| Self {
            width,
            height,
            rgb: rgb.into(),
        })
    }

    pub(crate) fn jpeg(&self) -> Option<Jpeg> {
        let (w, h) = (self.width as u32, self.height as u32);
        let longest = w.max(h);
        let whole;
        let (shown, w, h): (&[u8], u32, u32) = if longest > LONGEST_SIDE_PX {
            let scale = f64::from(LONGEST_SIDE_PX) / f64::from(longest);
            let side = |v: u32| ((f64::from(v) * scale).round() as u32).max(1);
            let full = RgbImage::from_raw(w, h, self.rgb.to_vec())?;
            whole = imageops::thumbnail(&full, side(w), side(h));
            (whole.as_raw(), side(w), side(h))
        } else {
            (&self.rgb, w, h)
        };
        let mut bytes = Vec::new();
        JpegEncoder::new_with_quality(&mut bytes, QUALITY)
            .encode(shown, w, h, ExtendedColorType::Rgb8)
            .ok()?;
        Some(Jpeg {
            width: self.width,
            height: self.height,
            bytes: bytes.into(),
        })
    }

    /// `self` in red and `other` in cyan: grey where they agree. `None` when their sizes differ.
    pub(crate) fn blend(&self, other: &Picture) -> Option<Picture> {
        if (self.width, self.height) != (other.width, other.height) {
            return None;
        }
        let grey = |p: &[u8]| {
            ((299 * u32::from(p[0]) + 587 * u32::from(p[1]) + 114 * u32::from(p[2])) / 1000) as u8
        };
        let rgb = self
            .rgb
            .chunks_exact(3)
            .zip(other.rgb.chunks_exact(3))
            .flat_map(|(a, b)| [grey(a), grey(b), grey(b)])
            .collect();
        Picture::new(self.width, self.height, rgb)
    }
}

/// Every image of the page, embedded once and drawn wherever it is needed.
#[derive(Debug, Default)]
pub(crate) struct Gallery {
    pictures: BTreeMap<String, Jpeg>,
    /// Micrometres on the specimen per pixel, of those of which that is known.
    scales: BTreeMap<String, f64>,
}

impl Gallery {
    /// Takes an image under a name (letters and digits).
    pub(crate) fn add(&mut self, name: impl Into<String>, picture: Jpeg) {
        self.pictures.insert(name.into(), picture);
    }

    /// What a pixel of an image is on the specimen: from now on it is drawn with a scale bar.
    pub(crate) fn scaled(&mut self, name: impl Into<String>, um_per_px: Option<f64>) {
        if let Some(scale) = um_per_px.filter(|s| s.is_finite() && *s > 0.0) {
            self.scales.insert(name.into(), scale);
        }
    }

    pub(crate) fn size(&self, name: &str) -> Option<(f64, f64)> {
        let picture = self.pictures.get(name)?;
        Some((picture.width as f64, picture.height as f64))
    }

    /// The image as an element, its pixel centres at integer coordinates, with a scale bar where its scale is known.
    pub(crate) fn draw(&self, name: &str) -> String {
        let size = self.size(name).zip(self.scales.get(name));
        let bar = size.map_or(String::new(), |((w, h), scale)| bar(w, h, *scale));
        format!("<use href=\"#{name}\"/>{bar}")
    }

    /// An SVG with the image and what `overlay` draws on it in pixel coordinates; `None` for an unknown image.
    pub(crate) fn figure(&self, name: &str, label: &str, overlay: &str) -> Option<String> {
        let (w, h) = self.size(name)?;
        Some(format!(
            "<svg class=\"pic\" role=\"img\" viewBox=\"-0.5 -0.5 {w} {h}\" aria-label=\"{0}\"><title>{0}</title>{1}{overlay}</svg>",
            escape(label),
            self.draw(name)
        ))
    }

    /// Where the images are. Nothing is seen of it.
    pub(crate) fn embed(&self) -> String {
        let mut out = String::from(
            "<svg width=\"0\" height=\"0\" class=\"store\" aria-hidden=\"true\"><defs>\n",
        );
        for (name, p) in &self.pictures {
            let data = STANDARD.encode(&p.bytes);
            let _ = writeln!(
                out,
                "<image id=\"{name}\" x=\"-0.5\" y=\"-0.5\" width=\"{}\" height=\"{}\" preserveAspectRatio=\"none\" href=\"data:image/jpeg;base64,{data}\"/>",
                p.width, p.height
            );
        }
        out.push_str("</defs></svg>\n");
        out
    }
}

/// A scale bar at the lower right, a tenth to a quarter of the image long.
fn bar(width: f64, height: f64, um_per_px: f64) -> String {
    let length_um = nice_step(0.1 * width * um_per_px);
    let (right, y) = (0.97 * width, 0.95 * height);
    let left = right - length_um / um_per_px;
    let path = format!("M{} {}H{}", Attr(left), Attr(y), Attr(right));
    let words = match length_um {
        um if um >= 1000.0 => format!("{} mm", um / 1000.0),
        um if um >= 1.0 => format!("{um:.0} µm"),
        um => format!("{} nm", fixed(um * 1000.0, 0)),
    };
    format!(
        "<g class=\"scale\"><path class=\"under\" d=\"{path}\"/><path class=\"over\" d=\"{path}\"/>\
         <text class=\"mid\" x=\"{}\" y=\"{}\" font-size=\"{}\">{words}</text></g>",
        Attr((left + right) / 2.0),
        Attr(y - 0.022 * width),
        Attr(0.042 * width)
    )
}

/// A cross at the middle of an image, and the outline of the target where one is seen.
pub(crate) fn aim(width: f64, height: f64, outline: Option<&[[f64; 2]; 4]>) -> String {
    let (cx, cy) = ((width - 1.0) / 2.0, (height - 1.0) / 2.0);
    let r = width.min(height) * 0.06;
    let cross = format!(
        "M{} {}H{}M{} {}V{}",
        Attr(cx - r),
        Attr(cy),
        Attr(cx + r),
        Attr(cx),
        Attr(cy - r),
        Attr(cy + r)
    );
    let mut out =
        format!("<path class=\"halo\" d=\"{cross}\"/><path class=\"cross\" d=\"{cross}\"/>");
    if let Some(corners) = outline {
        let mut d = String::new();
        for (i, [x, y]) in corners.iter().enumerate() {
            let letter = if i == 0 { 'M' } else { 'L' };
            let _ = write!(d, "{letter}{} {}", Attr(*x), Attr(*y));
        }
        d.push('Z');
        let _ = write!(
            out,
            "<path class=\"halo\" d=\"{d}\"/><path class=\"outline\" d=\"{d}\"/>"
        );
        let middle = |k: usize| corners.iter().map(|c| c[k]).sum::<f64>() / 4.0;
        let _ = write!(
            out,
            "<circle class=\"dot\" cx=\"{}\" cy=\"{}\" r=\"{}\"/>",
            Attr(middle(0)),
            Attr(middle(1)),
            Attr(width * 0.009)
        );
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scale_bar_is_as_long_as_it_says() {
        for (um_per_px, words) in [
            (0.51, "50 µm"),
            (2.22, "200 µm"),
            (1.0, "100 µm"),
            (0.1, "10 µm"),
            (0.005, "500 nm"),
            (30.0, "2 mm"),
        ] {
            let bar = bar(640.0, 480.0, um_per_px);
            assert!(bar.contains(&format!(">{words}</text>")), "{bar}");
            let path = bar
                .split("d=\"M")
                .nth(1)
                .unwrap()
                .split('"')
                .next()
                .unwrap();
            let numbers: Vec<f64> = path.split([' ', 'H']).map(|n| n.parse().unwrap()).collect();
            let length_um = (numbers[2] - numbers[0]) * um_per_px;
            let said: f64 = words.split(' ').next().unwrap().parse().unwrap();
            let said_um = said
                * [("nm", 1e-3), ("µm", 1.0), ("mm", 1e3)]
                    .iter()
                    .find(|(u, _)| words.ends_with(u))
                    .unwrap()
                    .1;
            assert!(
                (length_um / said_um - 1.0).abs() < 0.01,
                "{um_per_px}: {length_um}"
            );
            assert!(
                (60.0..=165.0).contains(&(numbers[2] - numbers[0])),
                "{path}"
            );
        }
    }

    #[test]
    fn an_image_of_unknown_scale_has_no_bar() {
        let mut gallery = Gallery::default();
        let picture = Picture::new(8, 8, vec![100; 192]).unwrap();
        for name in ["known", "unknown", "odd"] {
            gallery.add(name, picture.jpeg().unwrap());
        }
        gallery.scaled("known", Some(0.5));
        gallery.scaled("unknown", None);
        gallery.scaled("odd", Some(f64::NAN));
        assert!(gallery.draw("known").contains("class=\"scale\""));
        for name in ["unknown", "odd"] {
            assert!(!gallery.draw(name).contains("scale"), "{name}");
        }
    }
}
