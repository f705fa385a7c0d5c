//! A target as one file that a person can copy: a tar archive of what it was made of.
//!
//! | member | what |
//! |---|---|
//! | `target.json` | how it was taken: objective, pixel size, stage pose, calibration, exposure, quality |
//! | `image.png` | the image as the camera gave it, in full depth; samples of 9 to 15 bits lie in the high bits of 16 |
//! | `shadows.png` | what lay on the camera, where something did: a grey image of 16 bits, 16384 is a clear pixel |
//! | `mask.png` | what of the image was seen to move with the stage, where that was looked at: a pixel for each cell, white where it moved |
//! | `features.bin` | the features and the name of their engine, little endian: "SSF2", length of the name (u32), name, width, height, count, form (0 bytes, 1 bits, 2 floats), components (u32), then for each x, y, sigma, angle, response (f32), octave (i8), layer (u8), bright (u8), 0, and the components (u8 or f32) |
//! | `SHA256SUMS` | the checksums of all others, as `sha256sum --check` reads them; its own is the target's id |

use crate::files::checksum;
use crate::folder::to_png;
use crate::{LibraryError, cameras};
use image::ExtendedColorType;
use scopeservo_features::{Features, Mask};
use scopeservo_scope::{
    Channels, FlatField, Frame, Kinematics, ObjectiveId, Samples, StagePose, Timestamp,
};
use scopeservo_servo::{Calibration, Picture, Taken, Target, TargetQuality};
use scopeservo_slide::{Samples as Stored, Wanted};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io::Read as _;
use std::sync::Arc;
use std::time::Duration;

/// A target as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptTarget {
    /// The checksum of all that it is made of; empty for one that is not kept yet, and for one of an earlier version.
    pub id: String,
    /// When, UTC.
    pub saved: String,
    /// The instrument's name.
    pub instrument: String,
    /// Where the stage was.
    pub stage: StagePose,
    /// The target.
    pub target: Target,
}

/// Version of the file.
pub(crate) const TARGET_SCHEMA: u32 = 2;
const SUMS: &str = "SHA256SUMS";
/// No member of a target is larger.
const LARGEST: u64 = 1 << 28;

/// `target.json`.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    schema: u32,
    /// What it was called first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    saved: String,
    instrument: String,
    objective: ObjectiveId,
    quality: Quality,
    periods_px: Vec<[f64; 2]>,
    /// Side of the mask's cells.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    mask_cell_px: Option<usize>,
    stage: StagePose,
    taken: Option<HowTaken>,
    /// The grey image of a target that was saved when nothing else was kept of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    picture: Option<Picture>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Quality {
    features: usize,
    /// How many of them were seen to move with the stage.
    moved: Option<usize>,
    /// How surely it is come back to. Those of earlier versions lack it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    expected: Option<TargetQuality>,
}

#[derive(Debug, Serialize, Deserialize)]
struct HowTaken {
    um_per_px: f64,
    kinematics: Kinematics,
    calibration: Option<Calibration>,
    bit_depth: u8,
    exposure_s: f64,
    exposure_start_s: f64,
    sequence: u64,
}

/// The bytes of a target's file, and the target's id. The name is for who has nothing but the file.
pub(crate) fn encode(
    kept: &KeptTarget,
    name: Option<&str>,
) -> Result<(Vec<u8>, String), LibraryError> {
    let target = &kept.target;
    let taken = target.taken.as_deref();
    let head = Head {
        schema: TARGET_SCHEMA,
        name: name.map(Into::into),
        saved: kept.saved.clone(),
        instrument: kept.instrument.clone(),
        objective: target.objective.clone(),
        quality: Quality {
            features: target.features.len(),
            moved: target.moved,
            expected: target.quality.clone(),
        },
        periods_px: target.periods_px.clone(),
        mask_cell_px: target.mask.as_ref().map(Mask::cell),
        stage: kept.stage,
        picture: target.picture.clone().filter(|_| taken.is_none()),
        taken: taken.map(|taken| HowTaken {
            um_per_px: taken.um_per_px,
            kinematics: taken.kinematics,
            calibration: taken.calibration.clone(),
            bit_depth: taken.frame.bit_depth,
            exposure_s: taken.frame.exposure.as_secs_f64(),
            exposure_start_s: taken.frame.exposure_start.seconds(),
            sequence: taken.frame.sequence,
        }),
    };
    let mut members = vec![("target.json", crate::folder::to_json(&head)?)];
    if let Some(taken) = taken {
        members.push(("image.png", png_of(&taken.frame)?));
        if let Some(shadows) = &taken.flat_field {
            members.push(("shadows.png", cameras::to_png(shadows)?));
        }
    }
    if let Some(mask) = &target.mask {
        let (size, cells) = mask.cells();
        members.push(("mask.png", to_png(&cells, size, ExtendedColorType::L8)?));
    }
    members.push(("features.bin", target.features.to_bytes()));
    let sums: String = members
        .iter()
        .map(|(name, bytes)| format!("{}  {name}\n", checksum(bytes)))
        .collect();
    let id = checksum(sums.as_bytes());
    members.push((SUMS, sums.into_bytes()));
    let mut archive = tar::Builder::new(Vec::new());
    for (name, bytes) in members {
        let mut header = tar::Header::new_ustar();
        header.set_size(bytes.len() as u64);
        header.set_mode(0o644);
        let put = archive.append_data(&mut header, name, bytes.as_slice());
        put.map_err(|e| LibraryError::Encode(e.to_string()))?;
    }
    let bytes = archive.into_inner();
    Ok((bytes.map_err(|e| LibraryError::Encode(e.to_string()))?, id))
}

/// The target of a file; else what is wrong with it.
pub(crate) fn decode(bytes: &[u8]) -> Result<KeptTarget, String> {
    let members = members(bytes)?;
    let member = |name: &str| members.get(name).ok_or(format!("it has no {name}"));
    let id = check(&members)?;
    let head: serde_json::Value =
        serde_json::from_slice(member("target.json")?).map_err(|e| e.to_string())?;
    if head["schema"] != TARGET_SCHEMA {
        return Err(format!(
            "it has schema {}, and this version reads {TARGET_SCHEMA}",
            head["schema"]
        ));
    }
    let head: Head = serde_json::from_value(head).map_err(|e| e.to_string())?;
    let features = Features::from_bytes(member("features.bin")?).map_err(|e| e.to_string())?;
    let of_picture = [features.width, features.height];
    let mask = members.get("mask.png").map(|png| {
        let cell = head.mask_cell_px.unwrap_or(0);
        mask(png, of_picture, cell).ok_or("its mask is that of another image")
    });
    let shadows = members.get("shadows.png").map(|png| cameras::from_png(png));
    let taken = match head.taken {
        None => None,
        Some(how) => Some(taken(
            how,
            head.stage,
            member("image.png")?,
            shadows.transpose()?,
        )?),
    };
    let gray = taken.as_ref().map(Taken::gray).transpose();
    let gray = gray.map_err(|e| e.to_string())?;
    Ok(KeptTarget {
        id,
        saved: head.saved,
        instrument: head.instrument,
        stage: head.stage,
        target: Target {
            objective: head.objective,
            features,
            picture: gray.as_ref().map(Picture::of).or(head.picture),
            periods_px: head.periods_px,
            moved: head.quality.moved,
            mask: mask.transpose()?,
            quality: head.quality.expected,
            taken: taken.map(Arc::new),
        },
    })
}

/// What a target was called first, where its file says so.
pub(crate) fn first_name(bytes: &[u8]) -> Option<String> {
    let members = members(bytes).ok()?;
    let head: serde_json::Value = serde_json::from_slice(members.get("target.json")?).ok()?;
    Some(head["name"].as_str()?.to_owned())
}

/// The mask over an image of this size.
fn mask(png: &[u8], [width, height]: [usize; 2], cell: usize) -> Option<Mask> {
    let image = scopeservo_slide::decode(png, &Wanted::default()).ok()?;
    match (image.channels, &image.samples) {
        (1, Stored::U8(cells)) => Mask::from_cells(width, height, cell, cells),
        _ => None,
    }
}

fn members(bytes: &[u8]) -> Result<BTreeMap<String, Vec<u8>>, String> {
    let mut archive = tar::Archive::new(bytes);
    let mut members = BTreeMap::new();
    for entry in archive.entries().map_err(|e| e.to_string())? {
        let mut entry = entry.map_err(|e| e.to_string())?;
        let name = entry.path().map_err(|e| e.to_string())?;
        let name = name.to_string_lossy().into_owned();
        if entry.size() > LARGEST {
            return Err(format!("{name} is too large"));
        }
        let mut content = Vec::new();
        entry.read_to_end(&mut content).map_err(|e| e.to_string())?;
        members.insert(name, content);
    }
    Ok(members)
}

/// Compares all checksums, and tells the id.
fn check(members: &BTreeMap<String, Vec<u8>>) -> Result<String, String> {
    let sums = members.get(SUMS).ok_or("its end is missing")?;
    let text = std::str::from_utf8(sums).map_err(|e| e.to_string())?;
    let mut told = BTreeMap::new();
    for line in text.lines() {
        let (sum, name) = line.split_once("  ").ok_or("its checksums make no sense")?;
        told.insert(name, sum);
    }
    for (name, content) in members.iter().filter(|(name, _)| *name != SUMS) {
        if told.get(name.as_str()) != Some(&checksum(content).as_str()) {
            return Err(format!("the checksum of {name} is another"));
        }
    }
    Ok(checksum(sums))
}

fn taken(
    how: HowTaken,
    stage: StagePose,
    png: &[u8],
    flat_field: Option<FlatField>,
) -> Result<Taken, String> {
    let seconds = |s: f64| Duration::try_from_secs_f64(s).map_err(|e| e.to_string());
    if !(1..=16).contains(&how.bit_depth) || how.um_per_px.is_nan() || how.um_per_px <= 0.0 {
        return Err("its numbers are those of no image".into());
    }
    let image = scopeservo_slide::decode(png, &Wanted::default()).map_err(|e| e.to_string())?;
    let shift = 16 - u32::from(how.bit_depth);
    let low = |samples: Vec<u16>| Samples::U16(samples.into_iter().map(|v| v >> shift).collect());
    let channels = match image.channels {
        1 => Channels::Gray,
        _ => Channels::Rgb,
    };
    let samples = match image.samples {
        Stored::U8(samples) => Samples::U8(samples),
        Stored::U16(samples) => low(samples),
    };
    if matches!(samples, Samples::U8(_)) != (how.bit_depth <= 8) {
        return Err("its image has another depth".into());
    }
    Ok(Taken {
        frame: Arc::new(Frame {
            width: image.width,
            height: image.height,
            channels,
            bit_depth: how.bit_depth,
            samples,
            sequence: how.sequence,
            exposure_start: Timestamp::from_start(seconds(how.exposure_start_s)?),
            exposure: seconds(how.exposure_s)?,
        }),
        flat_field: flat_field.map(Arc::new),
        um_per_px: how.um_per_px,
        calibration: how.calibration,
        stage,
        kinematics: how.kinematics,
    })
}

/// A frame as a PNG that viewers show in its true brightness, and nothing is lost of.
///
/// # Errors
/// [`LibraryError`] when it cannot be encoded.
pub fn png_of(frame: &Frame) -> Result<Vec<u8>, LibraryError> {
    let shift = 16_u32.saturating_sub(frame.bit_depth.into());
    let (bytes, color) = match (&frame.samples, frame.channels) {
        (Samples::U8(s), Channels::Gray) => (s.clone(), ExtendedColorType::L8),
        (Samples::U8(s), Channels::Rgb) => (s.clone(), ExtendedColorType::Rgb8),
        (Samples::U16(s), channels) => (
            s.iter().flat_map(|v| (v << shift).to_ne_bytes()).collect(),
            match channels {
                Channels::Gray => ExtendedColorType::L16,
                Channels::Rgb => ExtendedColorType::Rgb16,
            },
        ),
    };
    to_png(&bytes, [frame.width, frame.height], color)
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_features::{Descriptors, Keypoint};
    use scopeservo_servo::{Tried, Weakness};

    fn kept(bit_depth: u8, channels: Channels) -> KeptTarget {
        let samples = 40 * 30 * if channels == Channels::Rgb { 3 } else { 1 };
        let top = (1u32 << bit_depth) - 1;
        let value = |i: usize| (i as u32 * 7919 % (top + 1)) as u16;
        let samples = match bit_depth {
            ..=8 => Samples::U8((0..samples).map(|i| value(i) as u8).collect()),
            _ => Samples::U16((0..samples).map(value).collect()),
        };
        let frame = Frame {
            width: 40,
            height: 30,
            channels,
            bit_depth,
            samples,
            sequence: 12,
            exposure_start: Timestamp::from_start(Duration::from_millis(3250)),
            exposure: Duration::from_millis(10),
        };
        let shadows = |i: usize| if i < 50 { 0.5 } else { 1.0 };
        let taken = Taken {
            flat_field: Some(Arc::new(
                FlatField::new(40, 30, (0..1200).map(shadows).collect()).unwrap(),
            )),
            frame: Arc::new(frame),
            um_per_px: 0.25,
            calibration: None,
            stage: StagePose::default(),
            kinematics: Kinematics::SpecimenXyOnTop,
        };
        let keypoint = |i: u8| Keypoint {
            x: f32::from(i) + 0.125,
            y: 3.0,
            sigma: 2.5,
            angle: -1.0,
            response: 0.01,
            bright: i.is_multiple_of(2),
            octave: i32::from(i) - 1,
            layer: 2,
        };
        let target = Target {
            objective: ObjectiveId("40x".into()),
            features: Features {
                engine: "corners".into(),
                width: 40,
                height: 30,
                keypoints: (0..5).map(keypoint).collect(),
                descriptors: Descriptors::Floats {
                    length: 3,
                    data: (0..15u8).map(f32::from).collect(),
                },
            },
            picture: Some(Picture::of(&taken.gray().unwrap())),
            periods_px: vec![[12.0, 0.5]],
            moved: Some(5),
            mask: Some(Mask::of_cells(40, 30, 8, |[x, _]| x > 20.0)),
            quality: Some(TargetQuality {
                chance: 0.75,
                tried: vec![Tried {
                    objective: ObjectiveId("40x".into()),
                    views: 8,
                    found: 6,
                    misled: 0,
                }],
                features: 3,
                textured: 0.5,
                sigma_um: Some(0.02),
                sigma_deg: None,
                weakness: Some(Weakness::FewFeatures),
            }),
            taken: Some(Arc::new(taken)),
        };
        KeptTarget {
            id: String::new(),
            saved: "2026-11-26T04:00:00Z".into(),
            instrument: "lab".into(),
            stage: StagePose::default(),
            target,
        }
    }

    #[test]
    fn a_target_comes_back_to_the_last_bit() {
        for bit_depth in [8, 10, 12, 16] {
            for channels in [Channels::Gray, Channels::Rgb] {
                let kept = kept(bit_depth, channels);
                let (bytes, id) = encode(&kept, Some("spot")).unwrap();
                let back = decode(&bytes).unwrap();
                assert_eq!(back.id, id);
                assert_eq!(
                    KeptTarget {
                        id: String::new(),
                        ..back
                    },
                    kept
                );
            }
        }
    }

    #[test]
    fn any_byte_that_was_lost_or_changed_is_noticed_or_does_not_matter() {
        let kept = kept(8, Channels::Gray);
        let (bytes, _) = encode(&kept, Some("spot")).unwrap();
        let differs = |damaged: &[u8]| match decode(damaged) {
            Err(_) => false,
            Ok(back) => {
                KeptTarget {
                    id: String::new(),
                    ..back
                } != kept
            }
        };
        for at in (0..bytes.len()).step_by(61) {
            assert!(!differs(&bytes[..at]), "cut at {at}");
            let mut changed = bytes.clone();
            changed[at] ^= 0x10;
            assert!(!differs(&changed), "changed at {at}");
        }
    }
}
