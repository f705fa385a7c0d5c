//! Pairs of images with what is true of them: hard ones of one place, and ones that show different things.

use crate::camera::{frame, spoil};
use scopeservo_features::GrayImage;
use scopeservo_geometry::{Affine2, Mat2, SplitMix64, Vec2};
use scopeservo_slide::Slide;
use scopeservo_studies::warp::{Pair, SIZE, Source, about};
use std::error::Error;
use std::path::Path;

/// What a pair is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Family {
    /// One place, the view spoilt.
    Hard,
    /// The same where features are few.
    HardSparse,
    /// A specimen that repeats itself: any answer is one of many.
    Lattice,
    /// Another place of the slide, which the view does not show.
    Elsewhere,
    /// Another slide.
    OtherSlide,
    /// The other section of a series, where the target would lie in it.
    Serial,
    /// The mirror image of the view.
    Mirrored,
    /// A nearly blank view.
    Blank,
    /// Two places behind the same dust.
    Dust,
}

impl Family {
    pub(crate) const EACH: [Self; 9] = [
        Self::Hard,
        Self::HardSparse,
        Self::Lattice,
        Self::Elsewhere,
        Self::OtherSlide,
        Self::Serial,
        Self::Mirrored,
        Self::Blank,
        Self::Dust,
    ];
}

/// A view, a target and the truth.
pub(crate) struct Scene {
    pub(crate) slide: String,
    pub(crate) view: GrayImage,
    pub(crate) target: GrayImage,
    pub(crate) zoom: f64,
    /// Target pixel from view pixel; `None` where there is none.
    pub(crate) target_from_view: Option<Affine2>,
    /// What was done to the view.
    pub(crate) spoilt: &'static str,
}

/// A slide as a source of views.
pub(crate) struct Specimen {
    pub(crate) name: String,
    pub(crate) source: Source,
    /// The same with half as many pixels along both axes, and so on: a wide view is drawn from one of these.
    coarser: Vec<Source>,
}

/// Means of two by two pixels.
fn halved(source: &Source) -> Source {
    let (width, height) = (source.width / 2, source.height / 2);
    let at = |x: usize, y: usize| source.data[y * source.width + x];
    let mean = |i: usize| {
        let (x, y) = (2 * (i % width), 2 * (i / width));
        0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
    };
    Source {
        width,
        height,
        data: (0..width * height).map(mean).collect(),
    }
}

impl Specimen {
    /// All of a folder, but for the second scan of one slide: that is the same tissue.
    pub(crate) fn all(folder: &Path) -> Result<Vec<Self>, Box<dyn Error>> {
        let mut files: Vec<_> = std::fs::read_dir(folder)?
            .filter_map(|e| Some(e.ok()?.path()))
            .filter(|p| p.extension().is_some_and(|x| x != "md"))
            .collect();
        files.sort();
        let mut all = Vec::new();
        for path in files {
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            if name == "cytology_scanner_b" {
                continue;
            }
            let gray = Slide::open(&path)?.read_gray(0)?;
            let source = Source {
                width: gray.width,
                height: gray.height,
                data: gray.data,
            };
            let source = source.landscape();
            let half = halved(&source);
            all.push(Self {
                name: name.into_owned(),
                coarser: vec![halved(&half), half],
                source,
            });
        }
        Ok(all)
    }

    /// Draws an image from the coarsest pixels that are no larger than its own.
    fn render(&self, source_from_pixel: &Affine2, seed: u64) -> GrayImage {
        let pitch = source_from_pixel.linear.det().abs().sqrt();
        let levels = [4.0, 2.0].into_iter().zip(&self.coarser);
        let (of, source) = levels
            .into_iter()
            .find(|(of, _)| pitch >= *of)
            .unwrap_or((1.0, &self.source));
        let level_from_source = Affine2 {
            linear: Mat2::diagonal(1.0 / of, 1.0 / of),
            offset: [-(of - 1.0) / (2.0 * of); 2],
        };
        source.render(&level_from_source.after(source_from_pixel), NOISE, seed)
    }
}

const ZOOMS: [f64; 3] = [4.0, 2.0, 1.0];
const NOISE: f64 = 0.008;

/// Source pixels per target pixel: as large a view as the source allows.
fn pitch(source: &Source, zoom: f64) -> f64 {
    let across = (source.width as f64 / (1.2 * zoom * SIZE[0] as f64))
        .min(source.height as f64 / (1.4 * zoom * SIZE[1] as f64));
    across.min(1.5)
}

/// The share of blocks of 16 pixels that have structure.
pub(crate) fn busy(image: &GrayImage) -> f64 {
    const SIDE: usize = 16;
    let (w, h) = (image.width() / SIDE, image.height() / SIDE);
    let structured = (0..w * h).filter(|i| {
        let (x, y) = (i % w * SIDE, i / w * SIDE);
        let values = (0..SIDE * SIDE).map(|k| f64::from(image.get(x + k % SIDE, y + k / SIDE)));
        let (sum, squares) = values.fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
        let n = (SIDE * SIDE) as f64;
        squares / n - (sum / n).powi(2) > 0.03 * 0.03
    });
    structured.count() as f64 / (w * h) as f64
}

/// The scene of that number; `None` where the slides have none.
pub(crate) fn draw(family: Family, specimens: &[Specimen], number: u64) -> Option<Scene> {
    let mut rng = SplitMix64::new(number * 7919 + family as u64);
    let zoom = ZOOMS[number as usize % 3];
    let (first, second) = (rng.below(specimens.len()), rng.below(specimens.len() - 1));
    let specimen = &specimens[first];
    let other = &specimens[(first + 1 + second) % specimens.len()];
    let range = match family {
        Family::HardSparse => 0.04..0.25,
        _ => 0.25..1.1,
    };
    let pair = |s: &Specimen, rng: &mut SplitMix64| pair(s, zoom, &range, rng);
    let scene = |slide: String, view, target, target_from_view, spoilt| {
        Some(Scene {
            slide,
            view,
            target,
            zoom,
            target_from_view,
            spoilt,
        })
    };
    match family {
        Family::Hard | Family::HardSparse => {
            let p = pair(specimen, &mut rng)?;
            let (spoilt, view) = spoil(&p.view, &p.target_from_view, number / 3, &mut rng)?;
            scene(
                specimen.name.clone(),
                view,
                p.target,
                Some(p.target_from_view),
                spoilt,
            )
        }
        Family::Elsewhere => {
            let (view, target) = apart(specimen, zoom, &mut rng)?;
            scene(specimen.name.clone(), view, target, None, "")
        }
        Family::OtherSlide => {
            let (a, b) = (pair(specimen, &mut rng)?, pair(other, &mut rng)?);
            let name = format!("{}/{}", specimen.name, other.name);
            scene(name, a.view, b.target, None, "")
        }
        Family::Serial => serial(specimens, zoom, &mut rng),
        Family::Mirrored => {
            let p = pair(specimen, &mut rng)?;
            let w = p.view.width();
            let view = GrayImage::from_fn(w, p.view.height(), |x, y| p.view.get(w - 1 - x, y));
            scene(specimen.name.clone(), view.ok()?, p.target, None, "")
        }
        Family::Blank => {
            let p = pair(specimen, &mut rng)?;
            let (level, light) = (0.85, 0.1 * rng.uniform());
            let of = |x: usize, y: usize| {
                level - light * (x as f64 / 640.0 - 0.5).powi(2) + light * y as f64 / 2000.0
            };
            let view = frame(of, NOISE, &mut rng)?;
            scene(specimen.name.clone(), view, p.target, None, "")
        }
        Family::Lattice => lattice(zoom, number, &mut rng),
        Family::Dust => dust(specimens, number, &mut rng),
    }
}

/// A view and a target in it, at any place and angle.
fn pair(
    s: &Specimen,
    zoom: f64,
    range: &std::ops::Range<f64>,
    rng: &mut SplitMix64,
) -> Option<Pair> {
    let pitch = pitch(&s.source, zoom);
    let size = [s.source.width as f64, s.source.height as f64];
    let half = SIZE.map(|n| 0.5 * pitch * zoom * n as f64);
    let (source_from_view, source_from_target) = (0..200).find_map(|_| {
        let turn = 0.4 * (rng.uniform() - 0.5);
        let (sin, cos) = (turn.abs().sin(), turn.cos());
        let reach = [cos * half[0] + sin * half[1], sin * half[0] + cos * half[1]];
        let angle = rng.uniform() * std::f64::consts::TAU;
        let (mut centre, mut of_target) = ([0.0; 2], [0.0; 2]);
        for k in 0..2 {
            let room = size[k] - 2.0 * reach[k];
            centre[k] = reach[k] + room.max(0.0) * rng.uniform();
            let off = (rng.uniform() - 0.5) * half[k] * (1.0 - 1.0 / zoom).max(0.3);
            of_target[k] = centre[k] + off;
        }
        let target = about(of_target, angle, pitch);
        range
            .contains(&busy(&glance(&s.source, &target)?))
            .then(|| (about(centre, turn, pitch * zoom), target))
    })?;
    Some(Pair {
        view: s.render(&source_from_view, rng.next_u64()),
        target: s.render(&source_from_target, rng.next_u64()),
        target_from_view: source_from_target.inverse()?.after(&source_from_view),
        zoom,
    })
}

/// The nearest pixels of a source: enough to see whether something is there.
fn glance(source: &Source, source_from_pixel: &Affine2) -> Option<GrayImage> {
    let image = GrayImage::from_fn(SIZE[0], SIZE[1], |x, y| {
        let p = source_from_pixel.apply([x as f64, y as f64]);
        let [x, y] = [(p[0], source.width), (p[1], source.height)]
            .map(|(v, n)| v.round().clamp(0.0, n as f64 - 1.0) as usize);
        source.data[y * source.width + x]
    });
    image.ok()
}

/// Two windows of a slide that have nothing in common.
fn apart(s: &Specimen, zoom: f64, rng: &mut SplitMix64) -> Option<(GrayImage, GrayImage)> {
    let pitch = pitch(&s.source, zoom) * 0.7;
    let half = |p: f64| 0.5 * p * f64::hypot(SIZE[0] as f64, SIZE[1] as f64);
    let size = [s.source.width as f64, s.source.height as f64];
    (0..200).find_map(|_| {
        let mut place = |half: [f64; 2]| -> Option<Vec2> {
            let mut at = [0.0; 2];
            for k in 0..2 {
                let room = size[k] - 2.0 * half[k];
                if room <= 0.0 {
                    return None;
                }
                at[k] = half[k] + room * rng.uniform();
            }
            Some(at)
        };
        let of_view = SIZE.map(|n| 0.5 * pitch * zoom * n as f64);
        let of_target = [half(pitch); 2];
        let (a, b) = (place(of_view)?, place(of_target)?);
        let free = (0..2).any(|k| (a[k] - b[k]).abs() > of_view[k] + of_target[k]);
        let angle = rng.uniform() * std::f64::consts::TAU;
        let seeds = [rng.next_u64(), rng.next_u64()];
        if !free {
            return None;
        }
        let (of_view, of_target) = (about(a, 0.0, pitch * zoom), about(b, angle, pitch));
        let textured = |t: &Affine2| glance(&s.source, t).is_some_and(|g| busy(&g) > 0.25);
        (textured(&of_view) && textured(&of_target)).then(|| {
            let view = s.render(&of_view, seeds[0]);
            (view, s.render(&of_target, seeds[1]))
        })
    })
}

/// The view of one section, the target of the next at about the same place.
fn serial(specimens: &[Specimen], zoom: f64, rng: &mut SplitMix64) -> Option<Scene> {
    let section = |end: &str| specimens.iter().find(|s| s.name.ends_with(end));
    let (one, three) = (section("bulb_1")?, section("bulb_3")?);
    let pitch = pitch(&three.source, zoom).min(pitch(&one.source, zoom));
    let (of_view, of_target, at) = (0..200).find_map(|_| {
        let share = [0.2 + 0.6 * rng.uniform(), 0.2 + 0.6 * rng.uniform()];
        let place = |s: &Specimen, share: [f64; 2]| {
            [
                share[0] * s.source.width as f64,
                share[1] * s.source.height as f64,
            ]
        };
        let angle = rng.uniform() * std::f64::consts::TAU;
        let of_view = about(place(one, share), 0.2, pitch * zoom);
        let of_target = about(place(three, share), angle, pitch);
        let textured = glance(&three.source, &of_target).is_some_and(|g| busy(&g) > 0.25);
        textured.then_some((of_view, of_target, share))
    })?;
    let view = one.render(&of_view, rng.next_u64());
    let target = three.render(&of_target, rng.next_u64());
    Some(Scene {
        slide: format!("bulb at {:.2} {:.2}", at[0], at[1]),
        view,
        target,
        zoom,
        target_from_view: None,
        spoilt: "",
    })
}

/// Spots on a square lattice, disordered by 0 or 1 % of its pitch.
fn lattice(zoom: f64, number: u64, rng: &mut SplitMix64) -> Option<Scene> {
    let spacing = 24.0 + 30.0 * rng.uniform();
    let disorder = [0.0, 0.01][number as usize / 3 % 2];
    let seed = rng.next_u64();
    let off = |i: i64, j: i64| {
        let mut own = SplitMix64::new(
            seed ^ (i as u64).wrapping_mul(0x9E37_79B9) ^ (j as u64).wrapping_mul(0x85EB_CA6B),
        );
        [0.0; 2].map(|_: f64| disorder * own.normal())
    };
    // In target pixels.
    let light = |p: Vec2, width: f64| {
        let (ci, cj) = (
            (p[0] / spacing).round() as i64,
            (p[1] / spacing).round() as i64,
        );
        let mut sum = 0.0;
        for j in cj - 1..=cj + 1 {
            for i in ci - 1..=ci + 1 {
                let o = off(i, j);
                let d = f64::hypot(
                    p[0] - spacing * (i as f64 + o[0]),
                    p[1] - spacing * (j as f64 + o[1]),
                );
                sum += (-0.5 * (d / width).powi(2)).exp();
            }
        }
        0.8 - 0.5 * sum
    };
    let angle = rng.uniform() * std::f64::consts::TAU;
    let linear = Mat2::rotation(angle) * zoom;
    let (w, h) = (SIZE[0] as f64, SIZE[1] as f64);
    let place = [
        w * (0.3 + 0.4 * rng.uniform()),
        h * (0.3 + 0.4 * rng.uniform()),
    ];
    let moved = linear * place;
    let target_from_view = Affine2 {
        linear,
        offset: [w / 2.0 - moved[0], h / 2.0 - moved[1]],
    };
    let width = 0.2 * spacing;
    let target = frame(|x, y| light([x as f64, y as f64], width), NOISE, rng)?;
    let view = frame(
        |x, y| {
            light(
                target_from_view.apply([x as f64, y as f64]),
                width.max(0.7 * zoom),
            )
        },
        NOISE,
        rng,
    )?;
    Some(Scene {
        slide: format!("lattice {spacing:.0} px, {disorder}"),
        view,
        target,
        zoom,
        target_from_view: Some(target_from_view),
        spoilt: "",
    })
}

/// Thirty soft shadows of 15 %, the same on both images of two places.
fn dust(specimens: &[Specimen], number: u64, rng: &mut SplitMix64) -> Option<Scene> {
    let s = &specimens[rng.below(specimens.len())];
    let (view, target) = match number % 3 {
        0 => {
            let mut blank = || frame(|_, _| 0.85, NOISE, rng);
            (blank()?, blank()?)
        }
        _ => apart(s, 1.0, rng)?,
    };
    let spots: Vec<[f64; 3]> = (0..30)
        .map(|_| {
            [
                640.0 * rng.uniform(),
                480.0 * rng.uniform(),
                4.0 + 12.0 * rng.uniform(),
            ]
        })
        .collect();
    let shadow = |x: usize, y: usize| {
        let one = |[sx, sy, r]: &[f64; 3]| {
            let d = (x as f64 - sx).powi(2) + (y as f64 - sy).powi(2);
            1.0 - 0.15 * (-0.5 * d / (r * r)).exp()
        };
        spots.iter().map(one).product::<f64>()
    };
    let behind = |image: &GrayImage| {
        GrayImage::from_fn(image.width(), image.height(), |x, y| {
            image.get(x, y) * shadow(x, y) as f32
        })
    };
    Some(Scene {
        slide: if number.is_multiple_of(3) {
            "blank".into()
        } else {
            s.name.clone()
        },
        view: behind(&view).ok()?,
        target: behind(&target).ok()?,
        zoom: 1.0,
        target_from_view: None,
        spoilt: "",
    })
}
