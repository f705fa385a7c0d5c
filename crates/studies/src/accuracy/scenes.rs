//! The pairs of the study. Pair k of a cell (zoom, condition) is a function of the seed, the cell and k only. The eight
//! conditions of one zoom share their scenes: place, rotation and target of pair k are the same, the view is not.

use super::degrade::{Condition, Degradation};
use crate::warp::{Pair, SIZE, Source, about};
use scopeservo_geometry::{Affine2, SplitMix64, Vec2};
use scopeservo_sift::GrayImage;
use scopeservo_slide::{Slide, SlideError};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

/// Changes whenever the same seed gives other images; results of different sets are not mixed.
const SET: &str = "1";
/// The name of the set of pairs that a seed gives.
pub fn set_name(seed: u64) -> String {
    format!("{SET}.{seed}")
}

/// Pairs of each cell in the full study.
pub const PAIRS_PER_CELL: usize = 150;
/// How many target pixels a view pixel covers.
pub const ZOOMS: [usize; 3] = [1, 2, 4];
/// The slides. The last four are too small for 4:1, which needs 2560 x 1920 pixels.
pub const SPECIMENS: [&str; 9] = [
    "carcinoma_he.png",
    "embryo_section.png",
    "skin_he.svs",
    "cytology_scanner_a.tif",
    "cytology_scanner_b.tif",
    "liver_he.jpg",
    "liver_sirius_red.jpg",
    "olfactory_bulb_1.png",
    "olfactory_bulb_3.png",
];
/// Of them, those that 4:1 uses.
const LARGE: usize = 5;

/// Which scene: the zoom, and the number of the scene among those of this zoom. Written `4-017`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct SceneId {
    /// Target pixels per view pixel: one of [`ZOOMS`].
    pub zoom: usize,
    /// Its number.
    pub index: usize,
}

/// Which pair. Written `4-blur-017`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct PairId {
    /// The scene.
    pub scene: SceneId,
    /// What is wrong with the view.
    pub condition: Condition,
}

/// All scenes of a study with so many pairs in each cell; the zooms take turns, so that any part of it is balanced.
pub fn all_scenes(pairs_per_cell: usize) -> impl Iterator<Item = SceneId> {
    (0..pairs_per_cell).flat_map(|index| ZOOMS.map(|zoom| SceneId { zoom, index }))
}

impl SceneId {
    /// Reads `4-017`.
    pub fn parse(text: &str) -> Option<Self> {
        let (zoom, index) = text.split_once('-')?;
        let (zoom, index) = (zoom.parse().ok()?, index.parse().ok()?);
        ZOOMS.contains(&zoom).then_some(Self { zoom, index })
    }

    /// The slide it is taken from: they take turns.
    pub fn specimen(self) -> &'static str {
        let usable = if self.zoom == 4 {
            LARGE
        } else {
            SPECIMENS.len()
        };
        SPECIMENS[self.index % usable]
    }

    /// Source pixels per target pixel. Smaller zooms have room for larger pixels, which are sharper.
    fn target_pitch(self) -> f64 {
        match self.zoom {
            1 => 2.0,
            2 => 1.5,
            _ => 1.0,
        }
    }

    /// How far the target's centre may lie from the view's, as a share of half the view: the target stays inside the view
    /// where it is smaller, whatever its rotation.
    fn wander(self) -> f64 {
        match self.zoom {
            1 => 0.25,
            2 => 0.15,
            _ => 0.5,
        }
    }
}

impl std::fmt::Display for SceneId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}-{:03}", self.zoom, self.index)
    }
}

impl PairId {
    /// Reads `4-blur-017`.
    pub fn parse(text: &str) -> Option<Self> {
        let (zoom, rest) = text.split_once('-')?;
        let (condition, index) = rest.rsplit_once('-')?;
        Some(Self {
            scene: SceneId::parse(&format!("{zoom}-{index}"))?,
            condition: Condition::of(condition)?,
        })
    }
}

impl std::fmt::Display for PairId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let SceneId { zoom, index } = self.scene;
        write!(f, "{zoom}-{}-{index:03}", self.condition.name())
    }
}

/// The slides, read when first needed.
pub struct Slides {
    folder: PathBuf,
    read: BTreeMap<&'static str, Arc<Source>>,
}

impl Slides {
    /// Those of a folder.
    pub fn of(folder: PathBuf) -> Self {
        Self {
            folder,
            read: BTreeMap::new(),
        }
    }

    fn get(&mut self, name: &'static str) -> Result<Arc<Source>, SlideError> {
        if let Some(source) = self.read.get(name) {
            return Ok(source.clone());
        }
        let gray = Slide::open(&self.folder.join(name))?.read_gray(0)?;
        let source = Source {
            width: gray.width,
            height: gray.height,
            data: gray.data,
        };
        let source = Arc::new(source.landscape());
        self.read.insert(name, source.clone());
        Ok(source)
    }

    /// Renders a scene.
    ///
    /// # Errors
    /// Those of reading a slide.
    pub fn scene(&mut self, id: SceneId, seed: u64) -> Result<Scene, SlideError> {
        Ok(Scene::render(id, &*self.get(id.specimen())?, seed))
    }
}

/// What the pairs of one scene share.
pub struct Scene {
    /// Which one.
    pub id: SceneId,
    /// The set it belongs to.
    pub set: String,
    /// The target's frame.
    pub target: Vec<u8>,
    /// The truth: target pixel from view pixel.
    pub target_from_view: Affine2,
    /// The view before anything happens to it, grey 0 to 1.
    clean_view: Vec<f64>,
    seed: u64,
}

impl Scene {
    /// Renders the scene from a source; view and target are each sampled once.
    ///
    /// # Panics
    /// When the source is too small, or has no texture at any of a thousand places.
    pub fn render(id: SceneId, source: &Source, seed: u64) -> Self {
        let set = set_name(seed);
        let seed = mixed(&[seed, id.zoom as u64, id.index as u64]);
        let mut rng = SplitMix64::new(seed);
        let target_pitch = id.target_pitch();
        let view_pitch = target_pitch * id.zoom as f64;
        let (view, target) = (0..1000)
            .map(|_| draw(id, source, target_pitch, view_pitch, &mut rng))
            .find(|(_, source_from_target)| textured(source, source_from_target))
            .expect("a slide has texture somewhere");
        let target_from_source = target.inverse().expect("a scaled rotation is regular");
        Self {
            id,
            set,
            target: Degradation::NONE.frame(&source.integrate(&target), &mut rng),
            target_from_view: target_from_source.after(&view),
            clean_view: source.integrate(&view),
            seed,
        }
    }

    /// What happens to the view under a condition, and the frame that comes of it.
    pub fn view(&self, condition: Condition) -> (Degradation, Vec<u8>) {
        let mut rng = SplitMix64::new(mixed(&[self.seed, condition as u64 + 1]));
        let degradation = Degradation::draw(condition, &mut rng, |rng| self.common(rng));
        let frame = degradation.frame(&self.clean_view, &mut rng);
        (degradation, frame)
    }

    /// A point of the view, at random among those that the target shows.
    fn common(&self, rng: &mut SplitMix64) -> Vec2 {
        let view_from_target = self.target_from_view.inverse();
        let view_from_target = view_from_target.expect("a known warp is regular");
        let [w, h] = SIZE.map(|n| n as f64 - 1.0);
        loop {
            let p = view_from_target.apply([w * rng.uniform(), h * rng.uniform()]);
            if (0.0..=w).contains(&p[0]) && (0.0..=h).contains(&p[1]) {
                return p;
            }
        }
    }

    /// The pair under a condition, given the view's frame.
    pub fn pair(&self, view: &[u8]) -> Pair {
        Pair {
            view: gray(view),
            target: gray(&self.target),
            target_from_view: self.target_from_view,
            zoom: self.id.zoom as f64,
        }
    }

    /// A number that tells whether two programs saw the same two frames (FNV-1a).
    pub fn checksum(&self, view: &[u8]) -> String {
        let hash = view
            .iter()
            .chain(&self.target)
            .fold(0xCBF2_9CE4_8422_2325_u64, |hash: u64, byte| {
                (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01B3)
            });
        format!("{hash:016x}")
    }
}

/// Source from view and source from target at a random place.
fn draw(
    id: SceneId,
    source: &Source,
    target_pitch: f64,
    view_pitch: f64,
    rng: &mut SplitMix64,
) -> (Affine2, Affine2) {
    let half = SIZE.map(|n| 0.5 * view_pitch * n as f64);
    let centre = [(source.width, half[0]), (source.height, half[1])].map(|(size, half)| {
        let room = size as f64 - 2.0 * half - 8.0;
        assert!(room >= 0.0, "the source is too small for {id}");
        half + 4.0 + rng.uniform() * room
    });
    let mut off = |half: f64| (2.0 * rng.uniform() - 1.0) * half * id.wander();
    let target_centre = [centre[0] + off(half[0]), centre[1] + off(half[1])];
    let angle = rng.uniform() * std::f64::consts::TAU;
    (
        about(centre, 0.0, view_pitch),
        about(target_centre, angle, target_pitch),
    )
}

/// Whether at least a third of the target's blocks of 40 x 40 pixels show structure: a standard deviation of 0.03, by a
/// sample of every fifth pixel in each direction.
fn textured(source: &Source, source_from_target: &Affine2) -> bool {
    let (block, step) = (40, 5);
    let [columns, rows] = SIZE.map(|n| n / block);
    let busy = (0..columns * rows)
        .filter(|i| {
            let corner = [i % columns * block, i / columns * block];
            let per_side = block / step;
            let values: Vec<f64> = (0..per_side * per_side)
                .map(|j| {
                    let offset = [j % per_side * step, j / per_side * step];
                    let pixel = [0, 1].map(|k| (corner[k] + offset[k]) as f64);
                    let p = source_from_target.apply(pixel);
                    source.sample(p[0], p[1])
                })
                .collect();
            let n = values.len() as f64;
            let mean = values.iter().sum::<f64>() / n;
            let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
            variance.sqrt() > 0.03
        })
        .count();
    busy * 3 > columns * rows
}

/// A seed from several numbers.
fn mixed(parts: &[u64]) -> u64 {
    parts.iter().fold(0x5C0F_E5E2, |seed, part| {
        SplitMix64::new(seed ^ part.wrapping_mul(0x9E37_79B9_7F4A_7C15)).next_u64()
    })
}

fn gray(frame: &[u8]) -> GrayImage {
    let data = frame.iter().map(|v| f32::from(*v) / 255.0).collect();
    GrayImage::new(SIZE[0], SIZE[1], data).expect("a frame is finite and not empty")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waves of several lengths: texture everywhere.
    fn source() -> Source {
        let (width, height) = (2600, 1960);
        let data = (0..width * height)
            .map(|i| {
                let (x, y) = ((i % width) as f32, (i / width) as f32);
                0.5 + 0.2 * (0.11 * x + 0.07 * y).sin() + 0.2 * (0.05 * x).cos() * (0.09 * y).sin()
            })
            .collect();
        Source {
            width,
            height,
            data,
        }
    }

    #[test]
    fn names_are_read_as_they_are_written() {
        for zoom in ZOOMS {
            for condition in Condition::EACH {
                let scene = SceneId { zoom, index: 17 };
                let id = PairId { scene, condition };
                assert_eq!(PairId::parse(&id.to_string()), Some(id));
                assert_eq!(SceneId::parse(&scene.to_string()), Some(scene));
            }
        }
        assert_eq!(PairId::parse("3-clean-001"), None);
        assert_eq!(PairId::parse("1-dusty-001"), None);
    }

    #[test]
    fn a_pair_is_a_function_of_seed_cell_and_number() {
        let source = source();
        let id = SceneId { zoom: 4, index: 3 };
        let (a, b) = (Scene::render(id, &source, 1), Scene::render(id, &source, 1));
        assert!(a.target == b.target && a.target_from_view == b.target_from_view);
        let (all, clean) = (a.view(Condition::All), a.view(Condition::Clean));
        // Whatever else was asked for before.
        assert_eq!(b.view(Condition::Clean), clean);
        assert_eq!(b.view(Condition::All), all);
        assert_eq!(a.checksum(&all.1), b.checksum(&all.1));
        assert_ne!(a.checksum(&all.1), a.checksum(&clean.1));
        let other = Scene::render(id, &source, 2);
        assert_ne!(a.target_from_view, other.target_from_view);
        let next = Scene::render(SceneId { index: 4, ..id }, &source, 1);
        assert_ne!(a.target_from_view, next.target_from_view);
    }

    #[test]
    fn a_smaller_target_lies_inside_the_view_and_has_the_zoom() {
        let source = source();
        for (zoom, index) in [(2, 0), (2, 1), (2, 2), (4, 0), (4, 1), (4, 2)] {
            let scene = Scene::render(SceneId { zoom, index }, &source, 7);
            let scale = scene.target_from_view.linear.det().sqrt();
            assert!((scale - zoom as f64).abs() < 1e-9);
            let back = scene.target_from_view.inverse().unwrap();
            let [w, h] = SIZE.map(|n| n as f64 - 1.0);
            for corner in [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]] {
                let p = back.apply(corner);
                assert!((0.0..=w).contains(&p[0]) && (0.0..=h).contains(&p[1]));
            }
        }
    }

    #[test]
    fn view_and_target_show_the_same_where_the_truth_says() {
        let scene = Scene::render(SceneId { zoom: 1, index: 0 }, &source(), 1);
        let pair = scene.pair(&scene.view(Condition::Clean).1);
        let (mut sum_sq, mut n) = (0.0, 0.0);
        for y in (40..440).step_by(7) {
            for x in (40..600).step_by(7) {
                let p = pair.target_from_view.apply([x as f64, y as f64]);
                let [px, py] = p.map(|v| v.round());
                if !(0.0..640.0).contains(&px) || !(0.0..480.0).contains(&py) {
                    continue;
                }
                let target = pair.target.get(px as usize, py as usize);
                sum_sq += f64::from(pair.view.get(x, y) - target).powi(2);
                n += 1.0;
            }
        }
        // Two noises of 2 levels, and up to half a pixel of slope for want of interpolation; unrelated waves differ by 0.25.
        assert!((sum_sq / n).sqrt() < 0.03, "{}", (sum_sq / n).sqrt());
    }
}
