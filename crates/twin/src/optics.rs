//! Where a pixel looks, and how sharply.
//!
//! The map from a pixel p to the specimen, one line per device:
//! ```text
//! m = K^-1 (p - p0)            K = [[kx, skew ky], [0, ky]], p0 = ((w-1)/2, (h-1)/2)
//! c = R_ec m + eta + offset    R_ec = [[-sin phi, -cos phi], [-cos phi, sin phi]]
//! w = R(th) c + x              the stage carries the microscope
//! w = R(-th) (c - x)           it carries the specimen, rotation on top
//! w = R(-th) c - x             it carries the specimen, x and y on top
//! s = F R(-a) (w - d)          the slide lies at d, turned by a; F negates x when it is flipped
//! ```

use crate::affine::Affine;
use crate::config::{Config, MountConfig, ObjectiveConfig};
use crate::nosepiece::Offset;
use crate::slide::Slide;
use crate::stage::{Six, index};
use scopeservo_scope::{Axis, Kinematics, PositiveZ};

/// Wavelength of the light, um.
const WAVELENGTH_UM: f64 = 0.55;

/// What the microscope sees at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct View {
    /// Specimen coordinates (um) of a pixel.
    pub(crate) specimen_from_pixel: Affine,
    /// Defocus at the middle of the image, um; positive: too close.
    pub(crate) defocus_um: f64,
    /// Change of defocus per pixel to the right and down, um.
    pub(crate) slope_um: [f64; 2],
    /// Index of the objective.
    pub(crate) objective: usize,
    /// Whether light passes: not while the nosepiece turns.
    pub(crate) lit: bool,
    /// True place of the stage.
    pub(crate) stage: Six,
}

impl View {
    pub(crate) fn um_per_px(&self) -> f64 {
        self.specimen_from_pixel.determinant().abs().sqrt()
    }
}

/// The middle of an image, for each image its own.
pub(crate) fn principal_point(width: usize, height: usize) -> [f64; 2] {
    [0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0)]
}

/// c in um from a pixel.
fn end_effector_from_pixel(
    mount: &MountConfig,
    optics: &ObjectiveConfig,
    p0: [f64; 2],
    offset_um: [f64; 2],
) -> Affine {
    let kx = if mount.mirrored {
        -optics.kx_px_per_m
    } else {
        optics.kx_px_per_m
    };
    let ky = optics.ky_px_per_m;
    // K^-1 of the upper triangle [[kx, skew ky], [0, ky]], in um.
    let k_inverse = Affine([
        [1e6 / kx, -1e6 * mount.skew / kx, 0.0],
        [0.0, 1e6 / ky, 0.0],
    ]);
    let (s, c) = mount.phi_deg.to_radians().sin_cos();
    let r_ec = Affine([[-s, -c, 0.0], [-c, s, 0.0]]);
    let centre = [
        mount.eta_mm[0] * 1e3 + offset_um[0],
        mount.eta_mm[1] * 1e3 + offset_um[1],
    ];
    Affine::shift([-p0[0], -p0[1]])
        .then(&k_inverse)
        .then(&r_ec)
        .then(&Affine::shift(centre))
}

/// w in um from c in um.
fn world_from_end_effector(kinematics: Kinematics, pose: &Six) -> Affine {
    let x = [pose[index(Axis::X)] * 1e6, pose[index(Axis::Y)] * 1e6];
    let minus_x = Affine::shift([-x[0], -x[1]]);
    let th = pose[index(Axis::Rz)];
    match kinematics {
        Kinematics::MovesMicroscope => Affine::rotation(th).then(&Affine::shift(x)),
        Kinematics::SpecimenRotationOnTop => minus_x.then(&Affine::rotation(-th)),
        Kinematics::SpecimenXyOnTop => Affine::rotation(-th).then(&minus_x),
    }
}

/// World coordinates of a pixel, before the slide comes in.
pub(crate) fn world_from_pixel(
    config: &Config,
    mount: &MountConfig,
    pose: &Six,
    objective: usize,
    offset_um: [f64; 2],
) -> Affine {
    let p0 = principal_point(config.camera.width, config.camera.height);
    end_effector_from_pixel(mount, &config.optics[objective], p0, offset_um)
        .then(&world_from_end_effector(config.stage.kinematics, pose))
}

/// Everything about one instant: with a mount as it is now, and an objective that looks a little beside where it should.
pub(crate) fn view(
    config: &Config,
    (mount, slide): (&MountConfig, &Slide),
    pose: &Six,
    start_z: f64,
    (objective, offset): (usize, Offset),
    lit: bool,
) -> View {
    let p0 = principal_point(config.camera.width, config.camera.height);
    let optics = &config.optics[objective];
    let c_from_p = end_effector_from_pixel(mount, optics, p0, offset.centre_um);
    let world = c_from_p.then(&world_from_end_effector(config.stage.kinematics, pose));
    let defocus = |p: [f64; 2]| {
        let mut arm = c_from_p.apply(p);
        if config.stage.kinematics != Kinematics::MovesMicroscope {
            arm[0] -= pose[index(Axis::X)] * 1e6;
            arm[1] -= pose[index(Axis::Y)] * 1e6;
        }
        // Small rotations about x and y lift the end of the arm: z + rx y - ry x.
        let z = (pose[index(Axis::Z)] - start_z) * 1e6 + pose[index(Axis::Rx)] * arm[1]
            - pose[index(Axis::Ry)] * arm[0];
        let closer = match config.stage.positive_z {
            PositiveZ::Closer => z,
            PositiveZ::Apart => -z,
        };
        closer + slide.height_um(world.apply(p)) - offset.focus_um
    };
    let middle = defocus(p0);
    View {
        specimen_from_pixel: world.then(&slide.specimen_from_world()),
        defocus_um: middle,
        slope_um: [
            (defocus([p0[0] + 100.0, p0[1]]) - middle) / 100.0,
            (defocus([p0[0], p0[1] + 100.0]) - middle) / 100.0,
        ],
        objective,
        lit,
        stage: *pose,
    }
}

/// Depth of field of an aperture, um.
pub(crate) fn depth_of_field_um(numerical_aperture: f64) -> f64 {
    WAVELENGTH_UM / numerical_aperture.powi(2)
}

/// Standard deviation of the point spread, um, at a defocus (um).
///
/// In focus `0.21 lambda / NA`, the Gaussian nearest to the Airy disc; far from it half the radius of the light cone
/// `|dz| tan(asin NA)`. In between the cone sets in within the depth of field, as wave optics has it.
pub(crate) fn blur_um(numerical_aperture: f64, defocus_um: f64) -> f64 {
    let airy = 0.21 * WAVELENGTH_UM / numerical_aperture;
    let cone = 0.5 * numerical_aperture.asin().tan();
    let half_dof = 0.5 * depth_of_field_um(numerical_aperture);
    let dz_sq = defocus_um * defocus_um;
    let onset = dz_sq / (dz_sq + half_dof * half_dof);
    (airy * airy + cone * cone * dz_sq * onset).sqrt()
}

/// The point spread in one channel at a defocus of the image, with longitudinal chromatic aberration.
pub(crate) fn channel_blur_um(optics: &ObjectiveConfig, defocus_um: f64, channel: usize) -> f64 {
    let shift = optics.chromatic_dof[channel] * depth_of_field_um(optics.numerical_aperture);
    blur_um(optics.numerical_aperture, defocus_um - shift)
}

/// Share of the light in the halo of spherical aberration: none on the far side of focus.
pub(crate) fn halo(optics: &ObjectiveConfig, defocus_um: f64) -> f64 {
    if defocus_um <= 0.0 {
        return 0.0;
    }
    let u_sq = (defocus_um / depth_of_field_um(optics.numerical_aperture)).powi(2);
    optics.spherical * u_sq / (1.0 + u_sq)
}

/// The halo is this much wider than the rest.
pub(crate) const HALO_WIDTH: f64 = 2.2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_has_its_two_limits_and_grows() {
        let na = 0.65;
        assert!((blur_um(na, 0.0) - 0.21 * 0.55 / na).abs() < 1e-12);
        let far = 1000.0;
        assert!((blur_um(na, far) / (0.5 * far * na.asin().tan()) - 1.0).abs() < 1e-3);
        assert!(
            blur_um(na, 0.2) < 1.1 * blur_um(na, 0.0),
            "inside the depth of field"
        );
        for i in 0..100 {
            assert!(blur_um(na, 0.1 * f64::from(i + 1)) > blur_um(na, 0.1 * f64::from(i)));
        }
    }

    #[test]
    fn the_two_sides_of_focus_differ() {
        let o = &Config::realistic().optics[2];
        assert!(channel_blur_um(o, 2.0, 0) < channel_blur_um(o, -2.0, 0));
        assert!(channel_blur_um(o, 2.0, 2) > channel_blur_um(o, -2.0, 2));
        assert!(halo(o, 2.0) > 0.2 && halo(o, -2.0) == 0.0 && halo(o, 0.0) == 0.0);
    }
}
