//! What the texts and tags of a TIFF say of its images: pixel sizes, channels and the order of pages. Aperio's description, OME-XML and
//! ImageJ's.

use roxmltree::{Document, Node, ParsingOptions};

use super::directory::{self, Directory};
use crate::input::Input;

/// Pixel sizes that a microscope can have, um. Others are print resolutions.
const PLAUSIBLE_UM: std::ops::RangeInclusive<f64> = 0.01..=50.0;
/// Longer texts are not looked through.
const MAX_XML_BYTES: usize = 8 << 20;
/// Nor those of more elements.
const MAX_XML_NODES: u32 = 200_000;

/// What a file says of one of its images.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Described {
    /// Pixel size, um.
    pub(crate) um_per_px: Option<f64>,
    /// The names of its channels, empty where there is none; one or no channel: there is nothing to choose.
    pub(crate) channels: Vec<String>,
    /// The first page of each channel, as far as they are in this file.
    pub(crate) pages: Vec<Option<usize>>,
    /// The pages of the image: the first, and the one after the last.
    pub(crate) span: [usize; 2],
}

/// The images of a file by the text of its first directory; empty where it tells of none.
pub(crate) fn images(text: &str, pages: usize) -> Vec<Described> {
    if text.starts_with("ImageJ=") {
        return image_j(text, pages).into_iter().collect();
    }
    if text.trim_start().starts_with('<') && text.len() <= MAX_XML_BYTES {
        return ome(text).unwrap_or_default();
    }
    Vec::new()
}

/// `channels=2`, then slices and frames: the channel changes first.
fn image_j(text: &str, pages: usize) -> Option<Described> {
    let value = |key: &str| {
        let of = |l: &str| l.trim().strip_prefix(key)?.strip_prefix('=')?.parse().ok();
        text.lines().find_map(of)
    };
    let channels: usize = value("channels").unwrap_or(1);
    (1..=pages).contains(&channels).then(|| Described {
        um_per_px: None,
        channels: vec![String::new(); channels],
        pages: (0..channels).map(Some).collect(),
        span: [0, pages],
    })
}

/// Whether lengths of an ImageJ text are micrometres; its resolution tags then are pixels per um.
fn image_j_um(text: &str) -> bool {
    let unit = text.lines().find_map(|l| l.trim().strip_prefix("unit="));
    matches!(
        unit,
        Some("micron" | "microns" | "um" | "\u{b5}m" | "\u{3bc}m" | "\\u00B5m")
    )
}

fn ome(text: &str) -> Option<Vec<Described>> {
    let options = ParsingOptions {
        allow_dtd: false,
        nodes_limit: MAX_XML_NODES,
        ..ParsingOptions::default()
    };
    let document = Document::parse_with_options(text, options).ok()?;
    let root = document.root_element();
    if root.tag_name().name() != "OME" {
        return None;
    }
    let mut before = 0;
    let mut all = Vec::new();
    for image in root.children().filter(|n| n.has_tag_name_of("Image")) {
        for pixels in image.children().filter(|n| n.has_tag_name_of("Pixels")) {
            let described = ome_pixels(pixels, before)?;
            before = described.span[1];
            all.push(described);
        }
    }
    Some(all)
}

/// Elements whatever the name space, which changes with the version.
trait Named {
    fn has_tag_name_of(&self, name: &str) -> bool;
}

impl Named for Node<'_, '_> {
    fn has_tag_name_of(&self, name: &str) -> bool {
        self.is_element() && self.tag_name().name() == name
    }
}

fn number(node: Node<'_, '_>, name: &str) -> Option<usize> {
    node.attribute(name)?.trim().parse().ok()
}

fn children<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Vec<Node<'a, 'i>> {
    node.children()
        .filter(|n| n.has_tag_name_of(name))
        .collect()
}

/// One image, whose pages come after `before` others.
fn ome_pixels(pixels: Node<'_, '_>, before: usize) -> Option<Described> {
    let channels = children(pixels, "Channel");
    let size_c = number(pixels, "SizeC").unwrap_or(1).clamp(1, 10_000);
    let [size_z, size_t] =
        ["SizeZ", "SizeT"].map(|n| number(pixels, n).unwrap_or(1).clamp(1, 1_000_000));
    // A channel of three samples is one page in colour.
    let samples = |c: &Node<'_, '_>| number(*c, "SamplesPerPixel").unwrap_or(1);
    let count = match channels.iter().map(samples).sum::<usize>() == size_c {
        true => channels.len(),
        false => size_c,
    };
    // How many pages are between a channel and the next.
    let order = pixels.attribute("DimensionOrder").unwrap_or("XYCZT");
    let faster = order.chars().take_while(|axis| *axis != 'C');
    let stride = faster.fold(1, |n, axis| match axis {
        'Z' => n * size_z,
        'T' => n * size_t,
        _ => n,
    });
    let (first, pages) = ome_pages(pixels, before, count, stride);
    let name = |k: usize| {
        channels
            .get(k)
            .and_then(|c| c.attribute("Name"))
            .unwrap_or_default()
    };
    Some(Described {
        um_per_px: ome_size(pixels).and_then(plausible),
        channels: (0..count)
            .map(|k| name(k).chars().take(40).collect())
            .collect(),
        pages,
        span: [first, first.saturating_add(count * size_z * size_t)],
    })
}

/// The first page of the image, and that of each of its channels: one after the other, or told one by one.
fn ome_pages(
    pixels: Node<'_, '_>,
    before: usize,
    count: usize,
    stride: usize,
) -> (usize, Vec<Option<usize>>) {
    let in_order = |first: usize| {
        (
            first,
            (0..count).map(|c| Some(first + c * stride)).collect(),
        )
    };
    let data = children(pixels, "TiffData");
    let told = data
        .iter()
        .any(|d| d.attribute("FirstC").is_some() || d.attribute("IFD").is_some());
    match data.as_slice() {
        _ if !told => in_order(before),
        [all] if number(*all, "PlaneCount") != Some(1) => {
            in_order(number(*all, "IFD").unwrap_or(before))
        }
        each => {
            let mut pages = vec![None; count];
            for entry in each {
                let [c, z, t] =
                    ["FirstC", "FirstZ", "FirstT"].map(|n| number(*entry, n).unwrap_or(0));
                if let (Some(place), 0, 0, false) = (pages.get_mut(c), z, t, is_elsewhere(*entry)) {
                    *place = place.or(number(*entry, "IFD").or(Some(0)));
                }
            }
            (
                pages.iter().flatten().min().copied().unwrap_or(before),
                pages,
            )
        }
    }
}

/// Whether a page is in another file.
fn is_elsewhere(entry: Node<'_, '_>) -> bool {
    let own = entry.document().root_element().attribute("UUID");
    let there = children(entry, "UUID").first().and_then(|n| n.text());
    own.zip(there)
        .is_some_and(|(own, there)| own != there.trim())
}

/// Pixel size across and down, um.
fn ome_size(pixels: Node<'_, '_>) -> Option<[f64; 2]> {
    let side = |axis: &str| {
        let value: f64 = pixels
            .attribute(format!("PhysicalSize{axis}").as_str())?
            .trim()
            .parse()
            .ok()?;
        let unit = pixels
            .attribute(format!("PhysicalSize{axis}Unit").as_str())
            .unwrap_or("\u{b5}m");
        Some(value * um_of(unit)?)
    };
    match (side("X"), side("Y")) {
        (Some(x), Some(y)) => Some([x, y]),
        (one, other) => one.or(other).map(|um| [um, um]),
    }
}

/// Micrometres of a unit of OME.
fn um_of(unit: &str) -> Option<f64> {
    Some(match unit.trim() {
        "\u{b5}m" | "\u{3bc}m" | "um" | "micron" => 1.0,
        "nm" => 1e-3,
        "pm" => 1e-6,
        "\u{c5}" => 1e-4,
        "mm" => 1e3,
        "cm" => 1e4,
        "m" => 1e6,
        "in" => 25_400.0,
        _ => return None,
    })
}

fn plausible([x, y]: [f64; 2]) -> Option<f64> {
    (PLAUSIBLE_UM.contains(&x) && PLAUSIBLE_UM.contains(&y)).then_some(0.5 * (x + y))
}

/// Pixel size stated by the tags and the text of a page, um.
pub(crate) fn um_per_px(input: &Input<'_>, page: &Directory, text: &str) -> Option<f64> {
    if let Some(mpp) = aperio_mpp(text) {
        return Some(mpp);
    }
    let um_per_unit = match page.number(input, directory::RESOLUTION_UNIT) {
        _ if image_j_um(text) => 1.0,
        Ok(Some(2)) => 25_400.0,
        Ok(Some(3)) => 10_000.0,
        _ => return None,
    };
    let side = |tag: u16| Some(um_per_unit / page.fraction(input, tag)?);
    plausible([
        side(directory::X_RESOLUTION)?,
        side(directory::Y_RESOLUTION)?,
    ])
}

/// `MPP = 0.4990` in an Aperio description.
fn aperio_mpp(description: &str) -> Option<f64> {
    if !description.starts_with("Aperio") {
        return None;
    }
    let value = description
        .split('|')
        .filter_map(|field| field.split_once('='))
        .find(|(key, _)| key.trim() == "MPP")?
        .1;
    let mpp: f64 = value.trim().parse().ok()?;
    plausible([mpp, mpp])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mpp_is_read_from_aperio_only() {
        assert_eq!(
            aperio_mpp("Aperio Image\r\n1x1|AppMag = 20|MPP = 0.4990|Left = 2"),
            Some(0.499)
        );
        assert_eq!(aperio_mpp("Aperio|AppMag = 20"), None);
        assert_eq!(aperio_mpp("Other|MPP = 0.5"), None);
        assert_eq!(aperio_mpp("Aperio|MPP = 0"), None);
    }

    fn one(pixels: &str) -> Described {
        let text = format!(
            "<?xml version=\"1.0\"?><OME xmlns=\"x\"><Image ID=\"Image:0\">{pixels}</Image></OME>"
        );
        images(&text, 100).remove(0)
    }

    #[test]
    fn sizes_of_ome_in_every_unit() {
        let um = |attributes: &str| one(&format!("<Pixels SizeC=\"1\" {attributes}/>")).um_per_px;
        assert_eq!(um("PhysicalSizeX=\"0.5\" PhysicalSizeY=\"0.5\""), Some(0.5));
        assert_eq!(um("PhysicalSizeX=\"0.5\""), Some(0.5));
        let of = |v: &str, unit: &str| {
            um(&format!(
                "PhysicalSizeX=\"{v}\" PhysicalSizeXUnit=\"{unit}\" PhysicalSizeY=\"{v}\" PhysicalSizeYUnit=\"{unit}\""
            ))
        };
        assert_eq!(of("250", "nm"), Some(0.25));
        assert_eq!(of("0.002", "mm"), Some(2.0));
        assert_eq!(of("0.5", "&#181;m"), Some(0.5));
        assert_eq!(of("1", "pixel"), None);
        assert_eq!(of("7", "mm"), None, "no microscope");
        assert_eq!(of("x", "um"), None);
    }

    #[test]
    fn channels_are_found_in_every_order() {
        let pages = |order: &str| {
            one(&format!("<Pixels DimensionOrder=\"{order}\" SizeC=\"2\" SizeZ=\"5\" SizeT=\"3\"><TiffData/></Pixels>")).pages
        };
        assert_eq!(pages("XYCZT"), [Some(0), Some(1)]);
        assert_eq!(pages("XYZCT"), [Some(0), Some(5)]);
        assert_eq!(pages("XYZTC"), [Some(0), Some(15)]);
        assert_eq!(pages("XYTCZ"), [Some(0), Some(3)]);
        let told = one("<Pixels SizeC=\"3\"><Channel Name=\"DAPI\"/><Channel/><Channel Name=\"FITC\"/>
            <TiffData IFD=\"4\" FirstC=\"0\" PlaneCount=\"1\"/><TiffData IFD=\"2\" FirstC=\"2\" PlaneCount=\"1\"/></Pixels>");
        assert_eq!(told.pages, [Some(4), None, Some(2)]);
        assert_eq!(told.channels, ["DAPI", "", "FITC"]);
        let colour =
            one("<Pixels SizeC=\"3\"><Channel SamplesPerPixel=\"3\"/><TiffData/></Pixels>");
        assert_eq!(colour.channels.len(), 1);
    }

    #[test]
    fn several_images_lie_one_after_the_other() {
        let pixels = "<Image><Pixels SizeC=\"2\" SizeZ=\"2\" PhysicalSizeX=\"0.5\"/></Image>";
        let all = images(&format!("<OME>{pixels}{pixels}</OME>"), 8);
        assert_eq!([all[0].span, all[1].span], [[0, 4], [4, 8]]);
        assert_eq!(all[1].pages, [Some(4), Some(5)]);
    }

    #[test]
    fn texts_of_image_j() {
        let text = "ImageJ=1.53t\nimages=6\nchannels=2\nslices=3\nunit=micron\n";
        assert_eq!(images(text, 6)[0].pages, [Some(0), Some(1)]);
        assert!(image_j_um(text));
        assert!(!image_j_um("ImageJ=1\nunit=inch"));
        assert!(images("ImageJ=1\nchannels=9", 6).is_empty());
    }

    #[test]
    fn nonsense_tells_nothing() {
        for text in [
            "",
            "<",
            "<OME",
            "<x/>",
            "<OME><Image><Pixels SizeC=\"-1\"",
            "<!DOCTYPE a [<!ENTITY b \"c\">]><OME/>",
        ] {
            assert!(images(text, 3).is_empty(), "{text}");
        }
    }
}
