//! Pictures with some bytes changed, cut or doubled: each is read or refused, within its budget, and none makes the reader lose its way.

mod common;

use common::tif::{Form, Image, SHORT};
use scopeservo_slide::{Alpha, Budget, Choice, Samples, Wanted, decode};
use std::io::{Cursor, Write};

/// Mutants of each seed.
const MUTANTS: u32 = 500;

fn next(state: &mut u64) -> u64 {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn seeds() -> Vec<Vec<u8>> {
    let data: Vec<u8> = (0..40 * 24 * 12).map(|i: u32| (i * i / 7) as u8).collect();
    let rgb = image::RgbImage::from_raw(40, 24, data[..2880].to_vec()).unwrap();
    let mut seeds = vec![
        include_bytes!("data/progressive.jpg").to_vec(),
        include_bytes!("data/slope.j2k").to_vec(),
    ];
    for format in [image::ImageFormat::Png, image::ImageFormat::Jpeg] {
        for image in [
            image::DynamicImage::from(rgb.clone()),
            image::DynamicImage::from(rgb.clone()).into_luma8().into(),
        ] {
            let mut bytes = Cursor::new(Vec::new());
            image.write_to(&mut bytes, format).unwrap();
            seeds.push(bytes.into_inner());
        }
    }
    type Pack = fn(&[u8]) -> Vec<u8>;
    let packs: [(u64, Pack); 4] = [
        (1, |b| b.to_vec()),
        (8, deflate),
        (5, |b| {
            weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8)
                .encode(b)
                .unwrap()
        }),
        (50000, |b| {
            ruzstd::encoding::compress_to_vec(b, ruzstd::encoding::CompressionLevel::Fastest)
        }),
    ];
    for (form, (compression, pack)) in Form::all().into_iter().zip(packs) {
        for (samples, bits, photometric, kind, planar) in [
            (3, 8, 2, 1, 1),
            (1, 32, 1, 3, 1),
            (4, 8, 5, 1, 2),
            (1, 1, 0, 1, 1),
            (1, 8, 3, 1, 1),
        ] {
            let mut image = Image::new([40, 24], samples, bits, photometric);
            image
                .tag(259, SHORT, &[compression])
                .tag(339, SHORT, &[kind])
                .tag(284, SHORT, &[planar]);
            image.tag(274, SHORT, &[6]).tag(320, SHORT, &[300; 768]);
            let size =
                (16 * 16 * samples * bits / 8 / if planar == 2 { samples } else { 1 }) as usize;
            let count = 6 * if planar == 2 { samples as usize } else { 1 };
            image.tiles([16, 16], vec![pack(&data[..size]); count]);
            image.text(270, "<OME><Image><Pixels SizeC=\"2\" PhysicalSizeX=\"0.5\"><TiffData/></Pixels></Image></OME>");
            image.children = vec![image.clone()];
            seeds.push(form.file(&[image.clone(), image]));
        }
    }
    seeds
}

#[test]
fn mutants_are_read_or_refused() {
    let mut state = 7;
    let mut read = 0;
    for seed in seeds() {
        for k in 0..MUTANTS {
            let mut mutant = seed.clone();
            for _ in 0..1 + next(&mut state) % 4 {
                let n = mutant.len() as u64;
                // Heads and directories are where it matters, at either end.
                let at = match next(&mut state) % 3 {
                    0 => next(&mut state) % n,
                    1 => next(&mut state) % n.min(200),
                    _ => n - 1 - next(&mut state) % n.min(900),
                } as usize;
                match next(&mut state) % 5 {
                    0 => mutant.truncate(at.max(8)),
                    1 => mutant[at] = [0, 1, 0x7f, 0xff][(next(&mut state) % 4) as usize],
                    2 => drop(mutant.remove(at)),
                    _ => mutant[at] ^= 1 << (next(&mut state) % 8),
                }
                if mutant.len() < 9 {
                    break;
                }
            }
            let wanted = Wanted {
                choice: Choice {
                    page: (k % 5 == 1).then_some(1),
                    channel: (k % 5 == 2).then_some((k % 3) as usize),
                },
                alpha: if k % 2 == 0 {
                    Alpha::Dropped
                } else {
                    Alpha::OverWhite
                },
                budget: Budget { bytes: 8 << 20 },
            };
            if let Ok(picture) = decode(&mutant, &wanted) {
                read += 1;
                let samples = match picture.samples {
                    Samples::U8(v) => v.len(),
                    Samples::U16(v) => v.len(),
                };
                assert_eq!(samples, picture.width * picture.height * picture.channels);
            }
        }
    }
    assert!(
        read > 200,
        "only {read} were read: the mutants are not mild enough"
    );
}
