//! How the slide lies, and what happens to it.

use crate::affine::Affine;
use crate::config::SlideConfig;
use serde::{Deserialize, Serialize};

/// Something that happens to the specimen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SpecimenEvent {
    /// Something opaque lies on the specimen.
    Occlusion {
        /// Its middle, specimen um.
        centre_um: [f64; 2],
        /// Its sides along specimen x and y, um.
        size_um: [f64; 2],
        /// Its colour.
        rgb: [u8; 3],
    },
    /// An air bubble under the cover glass: a dark rim, a pale inside.
    Bubble {
        /// Its middle, specimen um.
        centre_um: [f64; 2],
        /// Its radius, um.
        radius_um: f64,
    },
    /// All stains fade: optical densities are multiplied by `factor` (below 1).
    Bleach {
        /// What is left of the optical density.
        factor: f64,
    },
    /// Another stain: optical densities (red, green, blue) are multiplied by this matrix.
    Restain {
        /// Rows give the new densities in red, green, blue.
        density: [[f64; 3]; 3],
    },
    /// The surface rises (the cover slip swells, the immersion pushes), um towards the objective.
    Height {
        /// By how much, um.
        um: f64,
    },
    /// Somebody cleans the slide: occlusions and bubbles go. Stains stay as they are.
    Clean,
}

impl SpecimenEvent {
    /// Haematoxylin and eosin washed out and replaced by a green and blue pair.
    pub fn counterstain() -> Self {
        Self::Restain {
            density: [[0.2, 0.8, 0.1], [0.1, 0.2, 0.5], [0.7, 0.1, 0.2]],
        }
    }
}

/// What lies on the specimen.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Cover {
    Rectangle {
        centre_um: [f64; 2],
        half_um: [f64; 2],
        rgb: [f32; 3],
    },
    Bubble {
        centre_um: [f64; 2],
        radius_um: f64,
    },
}

const IDENTITY: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// The changes to the specimen's look.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Effects {
    pub(crate) covers: Vec<Cover>,
    density: [[f64; 3]; 3],
}

impl Effects {
    pub(crate) fn none() -> Self {
        Self {
            covers: Vec::new(),
            density: IDENTITY,
        }
    }

    /// The density matrix, when it changes anything.
    pub(crate) fn stain(&self) -> Option<[[f32; 3]; 3]> {
        (self.density != IDENTITY).then(|| self.density.map(|r| r.map(|v| v as f32)))
    }
}

/// Transmission after the densities are mixed by `stain`.
pub(crate) fn restained(rgb: [f32; 3], stain: &[[f32; 3]; 3]) -> [f32; 3] {
    let density = rgb.map(|v| -v.max(0.002).ln());
    stain.map(|r| (-(r[0] * density[0] + r[1] * density[1] + r[2] * density[2])).exp())
}

/// `rgb` as seen through a cover, at a specimen point; edges are `edge_um` soft.
pub(crate) fn covered(rgb: [f32; 3], cover: &Cover, s: [f64; 2], edge_um: f64) -> [f32; 3] {
    match cover {
        Cover::Rectangle {
            centre_um,
            half_um,
            rgb: own,
        } => {
            // How far inside the nearer edge.
            let inside = (0..2)
                .map(|i| half_um[i] - (s[i] - centre_um[i]).abs())
                .fold(f64::INFINITY, f64::min);
            let share = soft(inside, edge_um);
            std::array::from_fn(|i| rgb[i] + share * (own[i] - rgb[i]))
        }
        Cover::Bubble {
            centre_um,
            radius_um,
        } => {
            let inside = radius_um - (s[0] - centre_um[0]).hypot(s[1] - centre_um[1]);
            let share = soft(inside, edge_um);
            let rim = (0.08 * radius_um).max(edge_um);
            let dark = 0.75 * share * (-(inside / rim).powi(2)).exp() as f32;
            // Air bends the light away: the inside is paler and loses contrast.
            rgb.map(|v| (v + 0.45 * share * (0.97 - v)) * (1.0 - dark))
        }
    }
}

fn soft(inside: f64, edge: f64) -> f32 {
    (0.5 + inside / edge).clamp(0.0, 1.0) as f32
}

/// The slide in its holder: `w = R(a) F s + d`.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Slide {
    angle_rad: f64,
    flip: f64,
    at_um: [f64; 2],
    /// World point where the surface is at `base_um`.
    anchor_um: [f64; 2],
    base_um: f64,
    tilt_mrad: [f64; 2],
    pub(crate) effects: Effects,
}

impl Slide {
    pub(crate) fn new(config: &SlideConfig) -> Self {
        Self {
            angle_rad: 0.0,
            flip: 1.0,
            at_um: [0.0; 2],
            anchor_um: [0.0; 2],
            base_um: 0.0,
            tilt_mrad: config.tilt_mrad,
            effects: Effects::none(),
        }
    }

    pub(crate) fn specimen_from_world(&self) -> Affine {
        Affine::shift([-self.at_um[0], -self.at_um[1]])
            .then(&Affine::rotation(-self.angle_rad))
            .then(&Affine([[self.flip, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    }

    fn world_from_specimen(&self) -> Affine {
        Affine([[self.flip, 0.0, 0.0], [0.0, 1.0, 0.0]])
            .then(&Affine::rotation(self.angle_rad))
            .then(&Affine::shift(self.at_um))
    }

    /// Height of the surface at a world point, um towards the objective.
    pub(crate) fn height_um(&self, world_um: [f64; 2]) -> f64 {
        self.base_um
            + (0..2)
                .map(|i| self.tilt_mrad[i] * 1e-3 * (world_um[i] - self.anchor_um[i]))
                .sum::<f64>()
    }

    fn put(&mut self, specimen_um: [f64; 2], world_um: [f64; 2]) {
        self.at_um = [0.0; 2];
        let turned = self.world_from_specimen().apply(specimen_um);
        self.at_um = [world_um[0] - turned[0], world_um[1] - turned[1]];
        self.anchor_um = world_um;
    }

    /// Lays a specimen point over a world point.
    pub(crate) fn lay(&mut self, specimen_um: [f64; 2], world_um: [f64; 2], angle_rad: f64) {
        self.angle_rad = angle_rad;
        self.flip = 1.0;
        self.put(specimen_um, world_um);
    }

    /// Out and in again, turned about a specimen point, which ends shifted; `rise_um` higher than before.
    pub(crate) fn remount(
        &mut self,
        about_um: [f64; 2],
        shift_um: [f64; 2],
        angle_rad: f64,
        flipped: bool,
        rise_um: f64,
    ) {
        let before = self.world_from_specimen().apply(about_um);
        let height = self.height_um(before);
        self.angle_rad += angle_rad;
        if flipped {
            self.flip = -self.flip;
        }
        self.put(about_um, [before[0] + shift_um[0], before[1] + shift_um[1]]);
        self.base_um = height + rise_um;
    }

    pub(crate) fn happen(&mut self, event: SpecimenEvent) {
        match event {
            SpecimenEvent::Occlusion {
                centre_um,
                size_um,
                rgb,
            } => self.effects.covers.push(Cover::Rectangle {
                centre_um,
                half_um: size_um.map(|v| 0.5 * v),
                rgb: rgb.map(|v| f32::from(v) / 255.0),
            }),
            SpecimenEvent::Bubble {
                centre_um,
                radius_um,
            } => self.effects.covers.push(Cover::Bubble {
                centre_um,
                radius_um,
            }),
            SpecimenEvent::Bleach { factor } => {
                self.effects.density = self.effects.density.map(|r| r.map(|v| v * factor));
            }
            SpecimenEvent::Restain { density } => {
                let old = self.effects.density;
                self.effects.density = density
                    .map(|row| std::array::from_fn(|j| (0..3).map(|k| row[k] * old[k][j]).sum()));
            }
            SpecimenEvent::Height { um } => self.base_um += um,
            SpecimenEvent::Clean => self.effects.covers.clear(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slide() -> Slide {
        let mut slide = Slide::new(&SlideConfig::default());
        slide.lay([30.0, -70.0], [125_400.0, 60.0], 0.4);
        slide
    }

    #[test]
    fn the_point_asked_for_lies_where_asked() {
        let s = slide();
        let back = s.specimen_from_world().apply([125_400.0, 60.0]);
        assert!((back[0] - 30.0).abs() < 1e-9 && (back[1] + 70.0).abs() < 1e-9);
    }

    #[test]
    fn a_remount_turns_about_its_point_and_shifts_it() {
        for flipped in [false, true] {
            let mut s = slide();
            let about = [100.0, 50.0];
            let before = s.world_from_specimen().apply(about);
            s.remount(about, [7.0, -3.0], 0.2, flipped, 1.0);
            let after = s.world_from_specimen().apply(about);
            assert!((after[0] - before[0] - 7.0).abs() < 1e-9);
            assert!((after[1] - before[1] + 3.0).abs() < 1e-9);
            let x = s.world_from_specimen().apply([101.0, 50.0]);
            let sign = if flipped { -1.0 } else { 1.0 };
            assert!((x[0] - after[0] - sign * 0.6f64.cos()).abs() < 1e-9);
            assert!((x[1] - after[1] - sign * 0.6f64.sin()).abs() < 1e-9);
        }
    }

    #[test]
    fn heights_are_kept_where_the_slide_is_held() {
        let mut s = slide();
        assert_eq!(s.height_um([125_400.0, 60.0]), 0.0);
        assert!((s.height_um([126_400.0, 60.0]) - 0.3).abs() < 1e-12);
        s.happen(SpecimenEvent::Height { um: 4.0 });
        assert_eq!(s.height_um([125_400.0, 60.0]), 4.0);
    }

    #[test]
    fn half_the_density_is_the_root_of_the_transmission() {
        let mut s = slide();
        assert_eq!(s.effects.stain(), None);
        s.happen(SpecimenEvent::Bleach { factor: 0.5 });
        let stain = s.effects.stain().unwrap();
        for (out, v) in restained([0.25, 0.5, 1.0], &stain)
            .into_iter()
            .zip([0.25f32, 0.5, 1.0])
        {
            assert!((out - v.sqrt()).abs() < 1e-6);
        }
    }

    #[test]
    fn stains_follow_one_another() {
        let mut s = slide();
        s.happen(SpecimenEvent::counterstain());
        s.happen(SpecimenEvent::Bleach { factor: 0.5 });
        let once = restained(
            restained(
                [0.3, 0.5, 0.7],
                &[[0.2, 0.8, 0.1], [0.1, 0.2, 0.5], [0.7, 0.1, 0.2]],
            ),
            &[[0.5, 0.0, 0.0], [0.0, 0.5, 0.0], [0.0, 0.0, 0.5]],
        );
        let both = restained([0.3, 0.5, 0.7], &s.effects.stain().unwrap());
        for i in 0..3 {
            assert!((once[i] - both[i]).abs() < 1e-5);
        }
    }
}
