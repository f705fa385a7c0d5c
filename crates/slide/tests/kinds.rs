//! Every kind of picture that programs of the field write gives the pixels that it was made of. The files are made here.

mod common;

use common::tif::{Form, Image, RATIONAL, SHORT};
use scopeservo_slide::{Choice, Picture, Samples, Slide, Wanted, decode};
use std::io::Write;

const W: u32 = 37;
const H: u32 = 23;

/// Grey, 0 to 255, something different everywhere.
fn level(x: u32, y: u32) -> u8 {
    (x * 5 + y * 11 + (x * y) % 7) as u8
}

fn rgb(x: u32, y: u32) -> [u8; 3] {
    [level(x, y), (x * 3) as u8, (y * 9 + x) as u8]
}

fn read(bytes: &[u8]) -> Picture {
    decode(bytes, &Wanted::default()).unwrap()
}

/// Reads all of a file as a slide: grey of a level.
fn gray_of(bytes: &[u8], level: usize) -> Vec<f32> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a");
    std::fs::write(&path, bytes).unwrap();
    Slide::open(&path).unwrap().read_gray(level).unwrap().data
}

fn bytes_of(picture: &Picture) -> Vec<u8> {
    match &picture.samples {
        Samples::U8(v) => v.clone(),
        Samples::U16(v) => v
            .iter()
            .map(|v| ((u32::from(*v) + 128) / 257) as u8)
            .collect(),
    }
}

fn expect_rgb(bytes: &[u8], what: &str) {
    let picture = read(bytes);
    assert_eq!(
        (picture.width, picture.height, picture.channels),
        (W as usize, H as usize, 3),
        "{what}"
    );
    let got = bytes_of(&picture);
    for y in 0..H {
        for x in 0..W {
            assert_eq!(
                got[3 * (y * W + x) as usize..][..3],
                rgb(x, y),
                "{what}: {x}, {y}"
            );
        }
    }
}

fn expect_gray(bytes: &[u8], what: &str) {
    let picture = read(bytes);
    assert_eq!(
        (picture.width, picture.height, picture.channels),
        (W as usize, H as usize, 1),
        "{what}"
    );
    let got = bytes_of(&picture);
    for y in 0..H {
        for x in 0..W {
            assert_eq!(got[(y * W + x) as usize], level(x, y), "{what}: {x}, {y}");
        }
    }
}

/// The pixels of tiles of `t` x `t`, row after row of them, each by `at`.
fn tiles(t: u32, at: impl Fn(u32, u32) -> Vec<u8>) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for ty in 0..H.div_ceil(t) {
        for tx in 0..W.div_ceil(t) {
            let pixels = (0..t * t)
                .flat_map(|i| at((tx * t + i % t).min(W - 1), (ty * t + i / t).min(H - 1)));
            all.push(pixels.collect());
        }
    }
    all
}

/// Strips of `rows` rows.
fn strips(rows: u32, at: impl Fn(u32, u32) -> Vec<u8>) -> Vec<Vec<u8>> {
    let strip = |y0: u32| {
        (y0..(y0 + rows).min(H))
            .flat_map(|y| (0..W).map(move |x| (x, y)))
            .flat_map(|(x, y)| at(x, y))
            .collect()
    };
    (0..H).step_by(rows as usize).map(strip).collect()
}

fn deflate(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

fn zstd(bytes: &[u8]) -> Vec<u8> {
    ruzstd::encoding::compress_to_vec(bytes, ruzstd::encoding::CompressionLevel::Fastest)
}

fn lzw(bytes: &[u8]) -> Vec<u8> {
    weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8)
        .encode(bytes)
        .unwrap()
}

/// All bytes as they are, as runs of one to 128.
fn pack_bits(bytes: &[u8]) -> Vec<u8> {
    bytes
        .chunks(100)
        .flat_map(|c| [&[c.len() as u8 - 1], c].concat())
        .collect()
}

#[test]
fn planes_in_strips_and_tiles_of_either_byte_order_and_width() {
    for form in Form::all() {
        let mut image = Image::new([W, H], 3, 8, 2);
        let planes = (0..3)
            .flat_map(|c| strips(5, |x, y| vec![rgb(x, y)[c]]))
            .collect();
        image.tag(284, SHORT, &[2]).strips(5, planes);
        expect_rgb(&form.file(&[image]), &format!("strips {form:?}"));

        let mut image = Image::new([W, H], 3, 8, 2);
        let planes = (0..3)
            .flat_map(|c| tiles(16, |x, y| vec![rgb(x, y)[c]]))
            .map(|t| deflate(&t))
            .collect();
        image
            .tag(284, SHORT, &[2])
            .tag(259, SHORT, &[8])
            .tiles([16, 16], planes);
        expect_rgb(&form.file(&[image]), &format!("tiles {form:?}"));

        let mut image = Image::new([W, H], 3, 16, 2);
        let deep = |x, y, c: usize| form.number(u64::from(rgb(x, y)[c]) * 257, 2);
        let planes = (0..3)
            .flat_map(|c| strips(H, |x, y| deep(x, y, c)))
            .collect();
        image.tag(284, SHORT, &[2]).strips(H.into(), planes);
        expect_rgb(&form.file(&[image]), &format!("16 bits {form:?}"));
    }
}

#[test]
fn every_compression_with_and_without_differences() {
    type Pack = fn(&[u8]) -> Vec<u8>;
    let packs: [(u64, Pack); 6] = [
        (1, |b| b.to_vec()),
        (5, lzw),
        (8, deflate),
        (32946, deflate),
        (32773, pack_bits),
        (50000, zstd),
    ];
    for (number, pack) in packs {
        for form in [
            Form::default(),
            Form {
                big_endian: true,
                wide: false,
            },
        ] {
            let packed = |chunks: Vec<Vec<u8>>| chunks.iter().map(|c| pack(c)).collect::<Vec<_>>();
            let mut image = Image::new([W, H], 3, 8, 2);
            image
                .tag(259, SHORT, &[number])
                .strips(4, packed(strips(4, |x, y| rgb(x, y).to_vec())));
            expect_rgb(&form.file(&[image]), &format!("{number}"));
            let mut image = Image::new([W, H], 1, 8, 1);
            image.tag(259, SHORT, &[number]).tiles(
                [16, 32],
                packed(tiles_of([16, 32], |x, y| vec![level(x, y)])),
            );
            expect_gray(&form.file(&[image]), &format!("tiles {number}"));
            if [5, 8, 50000].contains(&number) {
                let before = |x: u32, y: u32| if x == 0 { [0; 3] } else { rgb(x - 1, y) };
                let less = |x: u32, y: u32| {
                    (0..3)
                        .map(|c| rgb(x, y)[c].wrapping_sub(before(x, y)[c]))
                        .collect()
                };
                let mut image = Image::new([W, H], 3, 8, 2);
                image
                    .tag(259, SHORT, &[number])
                    .tag(317, SHORT, &[2])
                    .strips(4, packed(strips(4, less)));
                expect_rgb(&form.file(&[image]), &format!("differences {number}"));
                let deep = |x, y| u16::from(level(x, y)) * 257;
                let less = |x: u32, y: u32| {
                    let before = if x == 0 { 0 } else { deep(x - 1, y) };
                    form.number(deep(x, y).wrapping_sub(before).into(), 2)
                };
                let mut image = Image::new([W, H], 1, 16, 1);
                image
                    .tag(259, SHORT, &[number])
                    .tag(317, SHORT, &[2])
                    .strips(23, packed(strips(23, less)));
                expect_gray(
                    &form.file(&[image]),
                    &format!("differences of 16 bits {number}"),
                );
            }
        }
    }
}

fn tiles_of([tw, th]: [u32; 2], at: impl Fn(u32, u32) -> Vec<u8>) -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for ty in 0..H.div_ceil(th) {
        for tx in 0..W.div_ceil(tw) {
            let pixels = (0..tw * th)
                .flat_map(|i| at((tx * tw + i % tw).min(W - 1), (ty * th + i / tw).min(H - 1)));
            all.push(pixels.collect());
        }
    }
    all
}

#[test]
fn palettes_of_every_depth_and_indices_beyond_them() {
    for (bits, n) in [(8_u32, 256_u32), (4, 16), (2, 4), (1, 2)] {
        let colour = |k: u32| {
            [
                (k * 255 / (n - 1)) as u8,
                (k * 7 % 256) as u8,
                (255 - k * 255 / (n - 1)) as u8,
            ]
        };
        let index = |x: u32, y: u32| u32::from(level(x, y)) % n;
        let map: Vec<u64> = (0..3)
            .flat_map(|c| (0..n).map(move |k| u64::from(colour(k)[c]) * 257))
            .collect();
        let rows = |y: u32| {
            let mut row = vec![0_u8; (W * bits).div_ceil(8) as usize];
            for x in 0..W {
                let at = x * bits;
                row[at as usize / 8] |= (index(x, y) << (8 - bits - at % 8)) as u8;
            }
            row
        };
        let data: Vec<u8> = (0..H).flat_map(rows).collect();
        let mut image = Image::new([W, H], 1, bits.into(), 3);
        image.tag(320, SHORT, &map).strips(H.into(), vec![data]);
        let file = Form::default().file(&[image.clone()]);
        let got = bytes_of(&read(&file));
        for y in 0..H {
            for x in 0..W {
                assert_eq!(
                    got[3 * (y * W + x) as usize..][..3],
                    colour(index(x, y)),
                    "{bits}: {x}, {y}"
                );
            }
        }
        // Eight bits of colour where sixteen belong, as some write.
        let small: Vec<u64> = map.iter().map(|v| v / 257).collect();
        image.tag(320, SHORT, &small);
        assert_eq!(
            bytes_of(&read(&Form::default().file(&[image.clone()]))),
            got,
            "{bits}"
        );
        // A palette without the last colour, which pixels have.
        let cut: Vec<u64> = map
            .chunks(n as usize)
            .flat_map(|c| c[..c.len() - 1].to_vec())
            .collect();
        image.tag(320, SHORT, &cut);
        let e = decode(&Form::default().file(&[image]), &Wanted::default()).unwrap_err();
        assert!(e.to_string().contains("of a palette of"), "{e}");
    }
}

#[test]
fn png_palettes_and_indices_beyond_them() {
    for (depth, n) in [
        (png::BitDepth::Eight, 200_u8),
        (png::BitDepth::Four, 9),
        (png::BitDepth::Two, 3),
    ] {
        let bits = depth as u32;
        let colours: Vec<u8> = (0..n).flat_map(|k| [k, 255 - k, 7]).collect();
        let write = |most: u8| {
            let mut row = vec![0; (W * bits).div_ceil(8) as usize];
            for x in 0..W {
                row[(x * bits / 8) as usize] |= ((x as u8) % most) << (8 - bits - x * bits % 8);
            }
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, W, 1);
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_depth(depth);
            encoder.set_palette(colours.clone());
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&row).unwrap();
            drop(writer);
            bytes
        };
        let good = bytes_of(&read(&write(n.min(37))));
        for x in 0..W as usize {
            let k = (x as u8) % n.min(37);
            assert_eq!(good[3 * x..][..3], [k, 255 - k, 7]);
        }
        if n < 37 {
            let e = decode(&write(n + 1), &Wanted::default()).unwrap_err();
            assert!(
                e.to_string()
                    .contains(&format!("colour {n} of a palette of {n}")),
                "{e}"
            );
        }
    }
}

#[test]
fn real_numbers_and_32_bits_and_no_extreme_one_decides() {
    let form = Form::default();
    let image = |bits: u64, kind: u64, at: &dyn Fn(f64) -> Vec<u8>, extreme: Option<f64>| {
        let mut image = Image::new([W, H], 1, bits, 1);
        let value = |x: u32, y: u32| match (x, y, extreme) {
            (9, 9, Some(v)) => v,
            _ => f64::from(level(x, y)),
        };
        let data = strips(7, |x, y| at(value(x, y)));
        image.tag(339, SHORT, &[kind]).strips(7, data);
        form.file(&[image])
    };
    type At<'a> = &'a dyn Fn(f64) -> Vec<u8>;
    let kinds: [(u64, u64, At<'_>, f64); 6] = [
        (32, 3, &|v| (v as f32).to_le_bytes().to_vec(), 1e9),
        (64, 3, &|v| v.to_le_bytes().to_vec(), -1e12),
        (32, 1, &|v| (v as u32).to_le_bytes().to_vec(), 4e9),
        (32, 2, &|v| (v as i32 - 100).to_le_bytes().to_vec(), -2e9),
        (
            16,
            2,
            &|v| (v as i16 - 100).to_le_bytes().to_vec(),
            32_000.0,
        ),
        (32, 3, &|v| (v as f32).to_le_bytes().to_vec(), f64::NAN),
    ];
    for (bits, kind, at, extreme) in kinds {
        for extreme in [None, Some(extreme)] {
            let got = gray_of(&image(bits, kind, at, extreme), 0);
            // A straight line through all but the extreme one.
            let points: Vec<(f32, f32)> = (0..W * H)
                .filter(|i| *i != 9 * W + 9)
                .map(|i| (f32::from(level(i % W, i / W)), got[i as usize]))
                .collect();
            let (low, high) = (
                points.iter().find(|p| p.0 < 3.0).unwrap(),
                points.iter().find(|p| p.0 > 250.0).unwrap(),
            );
            let slope = (high.1 - low.1) / (high.0 - low.0);
            assert!(slope * 255.0 > 0.15, "{bits} {kind} {extreme:?}: {slope}");
            for (v, g) in &points {
                assert!(
                    (g - low.1 - slope * (v - low.0)).abs() < 1e-3,
                    "{bits} {kind} {extreme:?}: {v} {g}"
                );
            }
        }
    }
    // From 0 to 1 they are what they are.
    let unit = image(32, 3, &|v| (v as f32 / 255.0).to_le_bytes().to_vec(), None);
    expect_gray(&unit, "0 to 1");
    let halves = image(16, 3, &|v| half(v / 256.0).to_le_bytes().to_vec(), None);
    let got = gray_of(&halves, 0);
    assert!((got[3] - f32::from(level(3, 0)) / 256.0).abs() < 1e-3);
}

/// A number from 0 to 1 in 16 bits, cut off.
fn half(v: f64) -> u16 {
    let bits = (v as f32).to_bits();
    let exponent = (bits >> 23) as i32 - 112;
    if exponent <= 0 {
        0
    } else {
        (exponent as u16) << 10 | (bits >> 13 & 1023) as u16
    }
}

#[test]
fn differences_of_real_numbers() {
    for form in [
        Form::default(),
        Form {
            big_endian: true,
            wide: false,
        },
    ] {
        let rows = |y: u32| {
            let values: Vec<[u8; 4]> = (0..W)
                .map(|x| (f32::from(level(x, y)) / 255.0).to_be_bytes())
                .collect();
            let mut row: Vec<u8> = (0..4)
                .flat_map(|k| values.iter().map(move |v| v[k]))
                .collect();
            for i in (1..row.len()).rev() {
                row[i] = row[i].wrapping_sub(row[i - 1]);
            }
            row
        };
        let mut image = Image::new([W, H], 1, 32, 1);
        let data: Vec<u8> = (0..H).flat_map(rows).collect();
        image
            .tag(339, SHORT, &[3])
            .tag(259, SHORT, &[8])
            .tag(317, SHORT, &[3])
            .strips(H.into(), vec![deflate(&data)]);
        expect_gray(&form.file(&[image]), "predictor 3");
    }
}

#[test]
fn black_and_white_packed_and_as_a_fax() {
    let black = |x: u32, y: u32| (x / 3 + y / 2).is_multiple_of(2);
    let packed = |one_is_black: bool| -> Vec<u8> {
        let row = |y: u32| {
            let mut row = vec![0_u8; W.div_ceil(8) as usize];
            (0..W)
                .filter(|x| black(*x, y) == one_is_black)
                .for_each(|x| row[x as usize / 8] |= 0x80 >> (x % 8));
            row
        };
        (0..H).flat_map(row).collect()
    };
    let fax = {
        let mut encoder = fax::encoder::Encoder::new(fax::VecWriter::new());
        for y in 0..H {
            let pels = (0..W).map(|x| {
                if black(x, y) {
                    fax::Color::Black
                } else {
                    fax::Color::White
                }
            });
            encoder.encode_line(pels, W as u16).unwrap();
        }
        encoder.finish().unwrap().finish()
    };
    let backwards = fax.iter().map(|b| b.reverse_bits()).collect();
    let cases: [(u64, u64, u64, Vec<u8>); 6] = [
        (0, 1, 1, packed(true)),
        (1, 1, 1, packed(false)),
        (0, 32773, 1, pack_bits(&packed(true))),
        (1, 8, 1, deflate(&packed(false))),
        (0, 4, 1, fax),
        (0, 4, 2, backwards),
    ];
    for (photometric, compression, order, data) in cases {
        let mut image = Image::new([W, H], 1, 1, photometric);
        image
            .tag(259, SHORT, &[compression])
            .tag(266, SHORT, &[order])
            .strips(H.into(), vec![data]);
        let got = bytes_of(&read(&Form::default().file(&[image])));
        for (i, v) in (0..).zip(got) {
            let want = if black(i % W, i / W) { 0 } else { 255 };
            assert_eq!(v, want, "{photometric} {compression} at {i}");
        }
    }
}

#[test]
fn inks_in_8_and_16_bits_together_and_in_planes() {
    let inks = |x: u32, y: u32| [rgb(x, y)[0], rgb(x, y)[1], rgb(x, y)[2], (x + y) as u8];
    let want = |x: u32, y: u32| {
        let [c, m, k, black] = inks(x, y).map(|v| 255 - u32::from(v));
        [c, m, k].map(|v| f64::from(v * black) / 255.0)
    };
    for form in [
        Form::default(),
        Form {
            big_endian: true,
            wide: true,
        },
    ] {
        let deep = |v: u8| form.number(u64::from(v) * 257, 2);
        let mut together = Image::new([W, H], 4, 8, 5);
        together.strips(3, strips(3, |x, y| inks(x, y).to_vec()));
        let mut wide = Image::new([W, H], 4, 16, 5);
        wide.strips(
            3,
            strips(3, |x, y| inks(x, y).into_iter().flat_map(deep).collect()),
        );
        let mut planes = Image::new([W, H], 4, 8, 5);
        planes.tag(284, SHORT, &[2]).strips(
            23,
            (0..4)
                .flat_map(|c| strips(23, |x, y| vec![inks(x, y)[c]]))
                .collect(),
        );
        for image in [together, wide, planes] {
            let got = bytes_of(&read(&form.file(&[image])));
            for (i, c) in (0..W * H).zip(got.chunks(3)) {
                let want = want(i % W, i / W);
                for k in 0..3 {
                    assert!(
                        (f64::from(c[k]) - want[k]).abs() <= 1.0,
                        "{i}: {c:?} {want:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn tiles_that_were_never_written_are_blank() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.tif");
    let outside = [200, 201, 202];
    for compression in [1_u64, 8, 7] {
        let mut chunks = tiles(16, |x, y| rgb(x, y).to_vec());
        let packed = |tile: &Vec<u8>| match compression {
            8 => deflate(tile),
            7 => {
                let mut jpeg = Vec::new();
                let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 98);
                encoder
                    .encode(tile, 16, 16, image::ExtendedColorType::Rgb8)
                    .unwrap();
                jpeg
            }
            _ => tile.clone(),
        };
        chunks = chunks.iter().map(packed).collect();
        chunks[1] = Vec::new();
        chunks[3] = Vec::new();
        let mut image = Image::new([W, H], 3, 8, if compression == 7 { 6 } else { 2 });
        image
            .tag(259, SHORT, &[compression])
            .tiles([16, 16], chunks);
        std::fs::write(&path, Form::default().file(&[image])).unwrap();
        let slide = Slide::open(&path).unwrap();
        let all = slide.read_rgb8(0, 0, 0, W, H, outside).unwrap();
        let gray = slide.read_gray(0).unwrap();
        let reduced = slide.read_gray_reduced(0, 100).unwrap();
        assert_eq!(reduced.1, 3);
        for y in 0..H {
            for x in 0..W {
                let (at, tile) = ((y * W + x) as usize, y / 16 * 3 + x / 16);
                if tile == 1 || tile == 3 {
                    assert_eq!(all.data[3 * at..][..3], outside, "{compression}: {x}, {y}");
                    assert_eq!(gray.data[at], 1.0, "glass is white");
                } else {
                    let off = all.data[3 * at].abs_diff(rgb(x, y)[0]);
                    assert!(
                        off <= if compression == 7 { 60 } else { 0 },
                        "{compression}: {x}, {y}: {off}"
                    );
                }
            }
        }
    }
    // Where black is nothing, nothing is black; strips too.
    let mut chunks = strips(8, |x, y| vec![level(x, y)]);
    chunks[1] = Vec::new();
    let mut image = Image::new([W, H], 1, 8, 1);
    image.strips(8, chunks);
    let gray = gray_of(&Form::default().file(&[image]), 0);
    assert_eq!(
        gray[8 * W as usize..16 * W as usize],
        vec![0.0; 8 * W as usize]
    );
    assert_eq!(gray[16 * W as usize], f32::from(level(0, 16)) / 255.0);
}

/// Where the pixel that is shown at (x, y) is stored, by the words of the standard: which side of the picture row 0 and column 0 are.
fn stored(number: u64, x: u32, y: u32) -> [u32; 2] {
    match number {
        2 => [W - 1 - x, y],
        3 => [W - 1 - x, H - 1 - y],
        4 => [x, H - 1 - y],
        5 => [y, x],
        6 => [y, H - 1 - x],
        7 => [W - 1 - y, H - 1 - x],
        8 => [W - 1 - y, x],
        _ => [x, y],
    }
}

#[test]
fn orientation_is_applied_whatever_file_tells_it() {
    let pixels = image::GrayImage::from_fn(W, H, |x, y| image::Luma([level(x, y)]));
    let mut plain = Vec::new();
    pixels
        .write_to(
            &mut std::io::Cursor::new(&mut plain),
            image::ImageFormat::Png,
        )
        .unwrap();
    let mut jpeg = Vec::new();
    let smooth = image::GrayImage::from_fn(W, H, |x, y| image::Luma([(4 * x + 3 * y) as u8]));
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 100)
        .encode_image(&smooth)
        .unwrap();
    for number in 1..=8_u64 {
        let exif = [
            &b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0"[..],
            &[number as u8],
            &[0; 6],
        ]
        .concat();
        let mut in_strips = Image::new([W, H], 1, 8, 1);
        in_strips
            .tag(274, SHORT, &[number])
            .strips(5, strips(5, |x, y| vec![level(x, y)]));
        let mut in_tiles = Image::new([W, H], 1, 8, 1);
        in_tiles
            .tag(274, SHORT, &[number])
            .tiles([16, 16], tiles(16, |x, y| vec![level(x, y)]));
        // After the header of a PNG of 33 bytes.
        let chunk = [b"eXIf", &exif[..]].concat();
        let crc = {
            let mut c = flate2::Crc::new();
            c.update(&chunk);
            c.sum()
        };
        let png = [
            &plain[..33],
            &(exif.len() as u32).to_be_bytes(),
            &chunk,
            &crc.to_be_bytes(),
            &plain[33..],
        ]
        .concat();
        let app = [b"Exif\0\0", &exif[..]].concat();
        let jpg = [
            &jpeg[..2],
            &[0xff, 0xe1],
            &(app.len() as u16 + 2).to_be_bytes(),
            &app,
            &jpeg[2..],
        ]
        .concat();
        let files = [
            Form::default().file(&[in_strips]),
            Form::default().file(&[in_tiles]),
            png,
            jpg,
        ];
        for (k, file) in files.iter().enumerate() {
            let picture = read(file);
            let (w, h) = if number > 4 { (H, W) } else { (W, H) };
            assert_eq!(
                (picture.width, picture.height),
                (w as usize, h as usize),
                "{number} {k}"
            );
            let got = bytes_of(&picture);
            let gray = gray_of(file, 0);
            let reduced = {
                let dir = tempfile::tempdir().unwrap();
                let path = dir.path().join("a");
                std::fs::write(&path, file).unwrap();
                let slide = Slide::open(&path).unwrap();
                let region = slide.read_rgb8(0, 3, 2, 9, 8, [7; 3]).unwrap();
                (slide.read_gray_reduced(0, 400).unwrap(), region)
            };
            let want = |x: u32, y: u32| {
                let [sx, sy] = stored(number, x, y);
                if k == 3 {
                    (4 * sx + 3 * sy) as u8
                } else {
                    level(sx, sy)
                }
            };
            let near = if k == 3 { 3 } else { 0 };
            for y in 0..h {
                for x in 0..w {
                    let at = (y * w + x) as usize;
                    assert!(
                        got[at].abs_diff(want(x, y)) <= near,
                        "{number} {k}: {x}, {y}"
                    );
                    assert!((gray[at] - f32::from(want(x, y)) / 255.0).abs() < 0.013);
                }
            }
            let ((small, factor), region) = reduced;
            assert_eq!(factor, 2);
            let mean = (0..4)
                .map(|i| f32::from(want(4 + i % 2, 6 + i / 2)))
                .sum::<f32>()
                / 4.0
                / 255.0;
            assert!(
                (small.data[3 * small.width + 2] - mean).abs() < 0.013,
                "{number} {k}"
            );
            assert!(
                region.data[3 * (4 * 9 + 5)].abs_diff(want(8, 6)) <= near,
                "{number} {k}"
            );
        }
    }
}

/// A tiled grey image at a third of the size for each further level.
fn ome_page(scale: u32, of: impl Fn(u32, u32) -> u8) -> Image {
    let (w, h) = (W / scale, H / scale);
    let mut image = Image::new([w, h], 1, 8, 1);
    let mut chunks = Vec::new();
    for ty in 0..h.div_ceil(16) {
        for tx in 0..w.div_ceil(16) {
            let pixels =
                (0..256).map(|i| of((tx * 16 + i % 16) * scale, (ty * 16 + i / 16) * scale));
            chunks.push(pixels.collect());
        }
    }
    image.tiles([16, 16], chunks);
    image
}

fn ome(attributes: &str, inner: &str) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?><OME xmlns=\"http://www.openmicroscopy.org/Schemas/OME/2016-06\"><Image ID=\"Image:0\"><Pixels ID=\"Pixels:0\" Type=\"uint8\" {attributes}>{inner}</Pixels></Image></OME>"
    )
}

fn write(dir: &tempfile::TempDir, file: &[u8]) -> std::path::PathBuf {
    let path = dir.path().join("a.ome.tif");
    std::fs::write(&path, file).unwrap();
    path
}

#[test]
fn a_pyramid_in_sub_directories_has_its_levels_and_its_pixel_size() {
    let dir = tempfile::tempdir().unwrap();
    let sizes = [
        ("PhysicalSizeX=\"0.5\" PhysicalSizeY=\"0.5\"", 0.5),
        (
            "PhysicalSizeX=\"325\" PhysicalSizeXUnit=\"nm\" PhysicalSizeY=\"325\" PhysicalSizeYUnit=\"nm\"",
            0.325,
        ),
        (
            "PhysicalSizeX=\"0.002\" PhysicalSizeXUnit=\"mm\" PhysicalSizeY=\"0.002\" PhysicalSizeYUnit=\"mm\"",
            2.0,
        ),
    ];
    for (form, (attributes, um)) in Form::all().into_iter().zip(sizes) {
        let mut page = ome_page(1, level);
        page.text(
            270,
            &ome(
                &format!(
                    "DimensionOrder=\"XYCZT\" SizeC=\"1\" SizeZ=\"1\" SizeT=\"1\" {attributes}"
                ),
                "<TiffData/>",
            ),
        );
        page.children = vec![ome_page(2, level), ome_page(4, level)];
        let slide = Slide::open(&write(&dir, &form.file(&[page]))).unwrap();
        let widths: Vec<u32> = slide.levels().iter().map(|l| l.width).collect();
        assert_eq!(widths, [W, W / 2, W / 4], "{form:?}");
        assert!((slide.um_per_px().unwrap() - um).abs() < 1e-12);
        assert!((slide.levels()[1].downsample - 2.0).abs() < 0.1);
        let coarse = slide.read_gray(1).unwrap();
        assert_eq!(
            coarse.data[3 * coarse.width + 5],
            f32::from(level(10, 6)) / 255.0
        );
        assert_eq!(slide.choices().told(), None);
        let region = slide.read_rgb8(2, 1, 1, 1, 1, [0; 3]).unwrap();
        assert_eq!(region.data, [level(4, 4); 3]);
    }
}

#[test]
fn pages_and_channels_are_chosen_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let shade = |k: u8| ome_page(1, move |x, y| level(x, y) / 4 + 20 * k);
    let look = |path: &std::path::Path, page, channel| {
        let choice = Choice { page, channel };
        let slide = Slide::open_as(
            path,
            &Wanted {
                choice,
                ..Wanted::default()
            },
        )?;
        let told = slide.choices().told();
        Ok::<_, scopeservo_slide::SlideError>((
            (slide.read_gray(0)?.data[0] * 255.0).round() as u8 / 20,
            told,
        ))
    };
    let pages = || (0..6).map(shade).collect::<Vec<_>>();
    // Two channels at three heights, in either order, by OME and by ImageJ.
    for (text, second) in [
        (
            ome(
                "DimensionOrder=\"XYCZT\" SizeC=\"2\" SizeZ=\"3\" SizeT=\"1\"",
                "<Channel Name=\"DAPI\"/><Channel Name=\"FITC\"/><TiffData/>",
            ),
            1,
        ),
        (
            ome(
                "DimensionOrder=\"XYZCT\" SizeC=\"2\" SizeZ=\"3\" SizeT=\"1\"",
                "<TiffData/>",
            ),
            3,
        ),
        (
            "ImageJ=1.53\nimages=6\nchannels=2\nslices=3\nunit=micron\n".into(),
            1,
        ),
    ] {
        let mut all = pages();
        all[0].text(270, &text);
        if text.starts_with("ImageJ") {
            all[0]
                .tag(282, RATIONAL, &[4, 1])
                .tag(283, RATIONAL, &[4, 1]);
        }
        let path = write(&dir, &Form::default().file(&all));
        let (seen, told) = look(&path, None, None).unwrap();
        assert_eq!(seen, 0);
        assert!(told.unwrap().starts_with("2 channels"), "{text}");
        assert_eq!(look(&path, None, Some(1)).unwrap().0, second, "{text}");
        for page in 0..6 {
            assert_eq!(look(&path, Some(page), None).unwrap().0, page as u8);
        }
        let missing = look(&path, None, Some(2)).unwrap_err().to_string();
        assert!(
            missing.contains("channel 2 was asked for and the file has 2"),
            "{missing}"
        );
        let missing = look(&path, Some(6), None).unwrap_err().to_string();
        assert!(
            missing.contains("page 6 was asked for and the file has 6"),
            "{missing}"
        );
        if text.starts_with("ImageJ") {
            assert_eq!(Slide::open(&path).unwrap().um_per_px(), Some(0.25));
        }
    }
    // Pages of which nobody says what they are.
    let path = write(&dir, &Form::default().file(&pages()));
    let (_, told) = look(&path, None, None).unwrap();
    assert_eq!(told.unwrap(), "6 pages; looking at page 0");
    // Channels as samples of a pixel: together, in planes, and of colour.
    for planes in [false, true] {
        let mut image = Image::new([W, H], 5, 8, 1);
        let at = |x, y, k: u8| level(x, y) / 4 + 20 * k;
        match planes {
            true => image.tag(284, SHORT, &[2]).strips(
                23,
                (0..5)
                    .flat_map(|k| strips(23, |x, y| vec![at(x, y, k)]))
                    .collect(),
            ),
            false => image.strips(23, strips(23, |x, y| (0..5).map(|k| at(x, y, k)).collect())),
        };
        let path = write(&dir, &Form::default().file(&[image]));
        for k in 0..5 {
            let (seen, told) = look(&path, None, Some(k)).unwrap();
            assert_eq!(seen, k as u8, "planes {planes}");
            assert!(told.unwrap().starts_with("5 channels"));
        }
        assert!(look(&path, None, Some(5)).is_err());
    }
    let mut image = Image::new([W, H], 3, 8, 2);
    image.strips(23, strips(23, |_, _| vec![0, 41, 82]));
    let path = write(&dir, &Form::default().file(&[image]));
    assert_eq!(
        look(&path, None, None).unwrap().1,
        None,
        "colour is no choice"
    );
    assert_eq!(
        [0, 1, 2].map(|k| look(&path, None, Some(k)).unwrap().0),
        [0, 2, 4]
    );
}
