//! Images: kept as they came or compressed, and embedded once each.

use crate::shown;
use crate::svg::{Attr, nice_step};
use crate::text::{escape, fixed};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, RgbImage, imageops};
use scopeservo_scope::Frame;
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
    /// How many times as bright as taken.
    gain: f64,
}

/// A compressed image, with the size that it had before.
#[derive(Debug, Clone)]
pub(crate) struct Jpeg {
    pub(crate) width: usize,
    pub(crate) height: usize,
    bytes: Arc<[u8]>,
    gain: f64,
}

impl Picture {
    /// `None` when the length does not fit the size, or there is nothing to see.
    pub(crate) fn new(width: usize, height: usize, rgb: Vec<u8>) -> Option<Self> {
        (!rgb.is_empty() && rgb.len() == width * height * 3).then(|| Self {
            width,
            height,
            rgb: rgb.into(),
            gain: 1.0,
        })
    }

    /// A frame as people see it.
    pub(crate) fn of(frame: &Frame) -> Option<Self> {
        let (rgb, gain) = shown::rgb8(frame);
        let picture = Self::new(frame.width, frame.height, rgb)?;
        Some(Self { gain, ..picture })
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
            gain: self.gain,
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

impl Jpeg {
    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes.to_vec()
    }
}

/// Every image of the page, embedded once and drawn wherever it is needed.
#[derive(Debug, Default)]
pub(crate) struct Gallery {
    pictures: BTreeMap<String, Jpeg>,
    /// Size of a pixel on the specimen, um, of those of which it is known.
    scales: BTreeMap<String, f64>,
}

impl Gallery {
    /// Takes an image under a name (letters and digits).
    pub(crate) fn add(&mut self, name: impl Into<String>, picture: Jpeg) {
        self.pictures.insert(name.into(), picture);
    }

    /// Tells the size of an image's pixel on the specimen, um: it gets a scale bar.
    pub(crate) fn scale(&mut self, name: impl Into<String>, um_per_px: Option<f64>) {
        let known = um_per_px.filter(|um| um.is_finite() && *um > 0.0);
        self.scales.extend(known.map(|um| (name.into(), um)));
    }

    /// The scale bar of an image, in its pixels; empty where the scale is not known.
    pub(crate) fn bar(&self, name: &str) -> String {
        let known = self.size(name).zip(self.scales.get(name));
        known.map_or(String::new(), |((w, h), um)| scale_bar([w, h], *um))
    }

    pub(crate) fn size(&self, name: &str) -> Option<(f64, f64)> {
        let picture = self.pictures.get(name)?;
        Some((picture.width as f64, picture.height as f64))
    }

    /// That images are shown brighter than they were taken, where they are: the end of a caption.
    pub(crate) fn brighter(&self, names: &[&str]) -> String {
        let gains = names
            .iter()
            .filter_map(|name| Some(self.pictures.get(*name)?.gain));
        match gains.fold(1.0, f64::max) {
            gain if gain > 1.0 => {
                format!(" Dim: shown {} times as bright as taken.", fixed(gain, 1))
            }
            _ => String::new(),
        }
    }

    /// The image as an element, its pixel centres at integer coordinates.
    pub(crate) fn draw(&self, name: &str) -> String {
        format!("<use href=\"#{name}\"/>")
    }

    /// An SVG with the image and what `overlay` draws on it in pixel coordinates; `None` for an unknown image.
    pub(crate) fn figure(&self, name: &str, label: &str, overlay: &str) -> Option<String> {
        let (w, h) = self.size(name)?;
        Some(format!(
            "<svg class=\"pic\" role=\"img\" viewBox=\"-0.5 -0.5 {w} {h}\" aria-label=\"{0}\"><title>{0}</title>{1}{overlay}{2}</svg>",
            escape(label),
            self.draw(name),
            self.bar(name)
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

/// A bar of a round length, a tenth to a quarter of the image's width, with its length.
fn scale_bar([w, h]: [f64; 2], um_per_px: f64) -> String {
    let length_um = nice_step(0.1 * w * um_per_px);
    let (length, thick, text) = (length_um / um_per_px, 0.010 * w, 0.042 * w);
    let (x, y) = (0.03 * w, h - 0.03 * w - thick);
    let words = match length_um >= 1000.0 {
        true => format!("{} mm", fixed(length_um / 1000.0, 0)),
        false => format!(
            "{} µm",
            fixed(length_um, (-length_um.log10().floor()).max(0.0) as usize)
        ),
    };
    format!(
        "<g class=\"scale-bar\"><rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/><text x=\"{}\" y=\"{}\" font-size=\"{}\">{words}</text></g>",
        Attr(x),
        Attr(y),
        Attr(length),
        Attr(thick),
        Attr(x),
        Attr(y - 0.4 * text),
        Attr(text)
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
        // A tenth to a quarter of 640 pixels, of a round length.
        for (um_per_px, words, px) in [
            (0.5, "50 µm", 100.0),
            (2.2, "200 µm", 90.91),
            (0.01, "1 µm", 100.0),
            (0.001, "0.1 µm", 100.0),
            (40.0, "5 mm", 125.0),
        ] {
            let bar = scale_bar([640.0, 480.0], um_per_px);
            assert!(bar.contains(&format!(">{words}<")), "{bar}");
            assert!(bar.contains(&format!("width=\"{px}\"")), "{bar}");
        }
        let mut gallery = Gallery::default();
        gallery.scale("view", Some(f64::NAN));
        gallery.scale("view", Some(0.0));
        assert_eq!(gallery.bar("view"), "");
    }
}
