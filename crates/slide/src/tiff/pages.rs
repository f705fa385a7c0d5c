//! Which directory of a TIFF is which image: pages, channels, and the levels of each.

use super::described::{self, Described};
use super::directory::{self, Directory};
use crate::input::Input;
use crate::{Choice, Choices, Fault};

/// A directory as far as it can be told apart from others.
struct Found {
    directory: Directory,
    size: [u32; 2],
    tiled: bool,
    /// It says itself that it is a reduced image or a mask.
    lesser: bool,
}

/// The levels of the image that was chosen, finest first, and what there was to choose from.
pub(crate) struct Chosen {
    pub(crate) levels: Vec<Directory>,
    pub(crate) um_per_px: Option<f64>,
    pub(crate) choices: Choices,
}

/// Finds the image that `choice` asks for; without a wish the finest tiled one, else the first.
pub(crate) fn choose(input: &Input<'_>, choice: Choice) -> Result<Chosen, Fault> {
    let all = directory::all(input)?;
    let text = all[0]
        .text(input, directory::DESCRIPTION)
        .unwrap_or_default();
    let images = described::images(&text, all.len());
    let mut found = Vec::with_capacity(all.len());
    for directory in all {
        let kind = directory
            .number(input, directory::NEW_SUBFILE_TYPE)?
            .unwrap_or(0);
        found.push(Found {
            // A later page of an unknown kind does not spoil the image.
            size: directory.size(input).unwrap_or([0, 0]),
            tiled: directory.has(directory::TILE_OFFSETS),
            lesser: kind & 5 != 0,
            directory,
        });
    }
    let sizes: Vec<_> = found.iter().map(|f| (f.size, f.tiled, f.lesser)).collect();
    let pages = pages_among(&sizes);
    let page = match (choice.page, choice.channel) {
        (Some(asked), _) if asked >= found.len() => {
            return Err(Fault::NotThere {
                what: "page",
                asked,
                available: found.len(),
            });
        }
        (Some(asked), _) => asked,
        (None, None) => pages[0],
        (None, Some(channel)) => page_of(&images, channel, found.len())?.unwrap_or(pages[0]),
    };
    let of = images
        .iter()
        .find(|d| (d.span[0]..d.span[1]).contains(&page));
    let chosen = &found[page];
    let text = match page {
        0 => text.clone(),
        _ => chosen
            .directory
            .text(input, directory::DESCRIPTION)
            .unwrap_or_default(),
    };
    let um_per_px = of
        .and_then(|d| d.um_per_px)
        .or_else(|| described::um_per_px(input, &chosen.directory, &text));
    let levels = levels_of(input, &found, &sizes, page)?;
    let channels = match (images.len(), of.or(images.first())) {
        (1.., Some(d)) if d.channels.len() > 1 => d.channels.clone(),
        _ => Vec::new(),
    };
    Ok(Chosen {
        levels,
        um_per_px,
        choices: Choices {
            pages: pages.len(),
            page,
            channel: of
                .and_then(|d| d.pages.iter().position(|p| *p == Some(page)))
                .unwrap_or(0),
            channels,
        },
    })
}

/// The directory of a page, and those of its reduced images, finest first: what hangs on it, or else follows it.
fn levels_of(
    input: &Input<'_>,
    found: &[Found],
    sizes: &[Seen],
    page: usize,
) -> Result<Vec<Directory>, Fault> {
    let mut reduced: Vec<(Directory, [u32; 2])> = Vec::new();
    for child in found[page].directory.children(input) {
        let size = child.size(input)?;
        reduced.push((child, size));
    }
    if reduced.is_empty() {
        let below = levels_below(sizes, page).into_iter();
        reduced = below
            .map(|k| (found[k].directory.clone(), found[k].size))
            .collect();
    }
    reduced.retain(|(_, size)| is_reduced(found[page].size, *size));
    reduced.sort_by_key(|(_, size)| std::cmp::Reverse(area(*size)));
    reduced.dedup_by_key(|(_, size)| *size);
    let reduced = reduced.into_iter().map(|(directory, _)| directory);
    Ok([found[page].directory.clone()]
        .into_iter()
        .chain(reduced)
        .collect())
}

/// The page of a channel of the first image that has several; none where channels are no pages.
fn page_of(images: &[Described], channel: usize, pages: usize) -> Result<Option<usize>, Fault> {
    let Some(image) = images.iter().find(|d| d.channels.len() > 1) else {
        return Ok(None);
    };
    match image.pages.get(channel) {
        Some(Some(page)) if *page < pages => Ok(Some(*page)),
        Some(_) => Err(Fault::Unsupported(format!(
            "channel {channel}, which lies in another file,"
        ))),
        None => Err(Fault::NotThere {
            what: "channel",
            asked: channel,
            available: image.channels.len(),
        }),
    }
}

type Seen = ([u32; 2], bool, bool);

fn area([w, h]: [u32; 2]) -> u64 {
    u64::from(w) * u64::from(h)
}

/// Whether an image of size `of`, reduced, may have size `size`: smaller, and of one shape.
fn is_reduced(of: [u32; 2], size: [u32; 2]) -> bool {
    let [w0, h0] = of.map(f64::from);
    let [w, h] = size.map(f64::from);
    let expected = h0 * w / w0;
    area(size) > 0 && area(size) < area(of) && (h - expected).abs() <= (0.01 * expected).max(2.0)
}

/// The directories that are images of their own, the one that is looked at without a wish first.
///
/// A file with tiled pages is a pyramid of those; its stripped pages are thumbnail, label and macro. Where none is tiled all are images, but
/// for those that say that they are reduced or a mask.
fn pages_among(pages: &[Seen]) -> Vec<usize> {
    let any_tiled = pages.iter().any(|p| p.1 && !p.2);
    let candidates = pages
        .iter()
        .enumerate()
        .filter(|(_, (size, tiled, lesser))| area(*size) > 0 && !lesser && (*tiled || !any_tiled));
    let mut own: Vec<usize> = candidates.map(|(k, _)| k).collect();
    if any_tiled {
        // The finest, and those as fine.
        let finest = own.iter().map(|k| area(pages[*k].0)).max().unwrap_or(0);
        own.retain(|k| area(pages[*k].0) == finest);
    }
    match own.is_empty() {
        true => vec![0],
        false => own,
    }
}

/// The directories that are reduced images of `page`, where none hangs on it: of tiled pages those of its shape, of others those that say so.
/// Where several images are as large, each has its own.
fn levels_below(pages: &[Seen], page: usize) -> Vec<usize> {
    let (size, tiled, _) = pages[page];
    let equal = |k: &usize| pages[*k].0 == size && pages[*k].1 == tiled;
    let rank = (0..page).filter(equal).count();
    let below: Vec<usize> = (0..pages.len())
        .filter(|k| {
            let (s, t, lesser) = pages[*k];
            is_reduced(size, s) && if tiled { t } else { lesser && !t }
        })
        .collect();
    let of_rank = |k: &usize| {
        below
            .iter()
            .filter(|j| *j < k && pages[**j].0 == pages[*k].0)
            .count()
            == rank
    };
    below.iter().copied().filter(|k| of_rank(k)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(w: u32, h: u32, tiled: bool) -> Seen {
        ([w, h], tiled, false)
    }

    #[test]
    fn levels_are_the_tiled_pages_of_one_shape() {
        // As in an SVS: level 0, thumbnail (strips), level 1, label and macro (strips), and a tiled stranger.
        let pages = [
            seen(4000, 3000, true),
            seen(1024, 768, false),
            seen(1000, 750, true),
            seen(387, 463, false),
            seen(1280, 431, false),
            seen(500, 700, true),
            seen(250, 187, true),
        ];
        assert_eq!(pages_among(&pages), [0]);
        assert_eq!(levels_below(&pages, 0), [2, 6]);
        assert_eq!(pages_among(&pages[1..2]), [0]);
        assert!(levels_below(&pages[1..2], 0).is_empty());
    }

    #[test]
    fn each_of_two_tiled_images_has_its_levels() {
        let pages = [
            seen(400, 300, true),
            seen(400, 300, true),
            seen(200, 150, true),
            seen(200, 150, true),
        ];
        assert_eq!(pages_among(&pages), [0, 1]);
        assert_eq!(levels_below(&pages, 0), [2]);
        assert_eq!(levels_below(&pages, 1), [3]);
    }

    #[test]
    fn pages_in_strips_are_images_unless_they_say_no() {
        let pages = [
            seen(400, 300, false),
            seen(200, 150, false),
            ([200, 150], false, true),
            seen(0, 0, false),
        ];
        assert_eq!(pages_among(&pages), [0, 1]);
        assert_eq!(levels_below(&pages, 0), [2]);
    }
}
