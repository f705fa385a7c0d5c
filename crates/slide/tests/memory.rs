//! What reading a picture holds stays below its budget, as the system counts it: each picture is read in a process of its own.

mod common;

use common::tif::{Form, Image, SHORT};
use scopeservo_slide::{Budget, Slide, SlideError, Wanted};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The child reads this file,
const FILE: &str = "SCOPESERVO_TEST_PICTURE";
/// within so many bytes,
const BYTES: &str = "SCOPESERVO_TEST_BYTES";
/// as grey of at most this many pixels, or in colour, whole.
const AS: &str = "SCOPESERVO_TEST_AS";
/// What a process holds that has read nothing, with room.
const IDLE_KB: u64 = 24 << 10;
const MB: u64 = 1 << 20;

/// Not a test by itself: what the other tests run again, in a process of its own.
#[test]
fn the_child_that_reads() {
    let (Ok(file), Ok(bytes), Ok(way)) =
        (std::env::var(FILE), std::env::var(BYTES), std::env::var(AS))
    else {
        return;
    };
    let budget = Budget {
        bytes: bytes.parse().unwrap(),
    };
    let wanted = Wanted {
        budget,
        ..Wanted::default()
    };
    let read = || -> Result<f64, SlideError> {
        let slide = Slide::open_as(Path::new(&file), &wanted)?;
        if way == "rgb" {
            let size = slide.levels()[0];
            let region =
                slide.read_rgb8(0, 5, 5, size.width.min(600), size.height.min(600), [255; 3])?;
            return Ok(f64::from(region.data[region.data.len() / 2]) / 255.0);
        }
        let (gray, _) = slide.read_gray_reduced(0, 1 << 20)?;
        let sum: f64 = gray.data.iter().map(|v| f64::from(*v)).sum();
        Ok(sum / gray.data.len() as f64)
    };
    let said = match read() {
        Ok(mean) => format!("mean {mean:.3}"),
        Err(e) => format!("error {e}"),
    };
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:"));
    let peak = peak.map_or("0", |l| l.trim().trim_end_matches("kB").trim());
    std::fs::write(format!("{file}.said"), format!("{peak}\n{said}")).unwrap();
}

/// Peak memory in kB, 0 where the system does not tell, and what was said.
fn child(file: &Path, bytes: u64, way: &str) -> (u64, String) {
    let output = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "the_child_that_reads", "--test-threads", "1"])
        .env(FILE, file)
        .env(BYTES, bytes.to_string())
        .env(AS, way)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}: {}",
        file.display(),
        String::from_utf8_lossy(&output.stdout)
    );
    let said = std::fs::read_to_string(format!("{}.said", file.display())).unwrap();
    let (peak, said) = said.split_once('\n').unwrap();
    (peak.parse().unwrap(), said.into())
}

/// Zeros and a few others, deflated without ever holding them.
fn deflated(count: u64, byte: u8) -> Vec<u8> {
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
    let block = vec![byte; 1 << 16];
    let mut left = count;
    while left > 0 {
        let n = left.min(1 << 16);
        encoder.write_all(&block[..n as usize]).unwrap();
        left -= n;
    }
    encoder.finish().unwrap()
}

fn png(
    [w, h]: [u32; 2],
    depth: u8,
    colour: u8,
    interlaced: bool,
    data: &[u8],
    more: &[(&[u8; 4], Vec<u8>)],
) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |name: &[u8; 4], data: &[u8]| {
        out.extend((data.len() as u32).to_be_bytes());
        let body = [name, data].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&body);
        out.extend(&body);
        out.extend(crc.sum().to_be_bytes());
    };
    let head = [
        &w.to_be_bytes()[..],
        &h.to_be_bytes(),
        &[depth, colour, 0, 0, interlaced.into()],
    ]
    .concat();
    chunk(b"IHDR", &head);
    more.iter().for_each(|(name, data)| chunk(name, data));
    chunk(b"IDAT", data);
    chunk(b"IEND", &[]);
    out
}

/// A grey JPEG of one level, of any size: all blocks but the first are two bits.
fn jpeg([w, h]: [u16; 2]) -> Vec<u8> {
    let mut small = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut small, 75)
        .encode(&[200; 64], 8, 8, image::ExtendedColorType::L8)
        .unwrap();
    let frame = small.windows(2).position(|p| p == [0xff, 0xc0]).unwrap();
    small[frame + 5..frame + 7].copy_from_slice(&h.to_be_bytes());
    small[frame + 7..frame + 9].copy_from_slice(&w.to_be_bytes());
    // A block that is as the one before: difference 0 (00), end of block (1010).
    let scan = small.windows(2).position(|p| p == [0xff, 0xda]).unwrap();
    let data = scan + 2 + usize::from(u16::from_be_bytes([small[scan + 2], small[scan + 3]]));
    let blocks = usize::from(w).div_ceil(8) * usize::from(h).div_ceil(8);
    small.truncate(data);
    let bits = "001010".repeat(4);
    let three: Vec<u8> = (0..3)
        .map(|k| u8::from_str_radix(&bits[8 * k..8 * k + 8], 2).unwrap())
        .collect();
    for _ in 0..blocks.div_ceil(4) {
        small.extend(&three);
    }
    small.extend([0xff, 0xd9]);
    small
}

fn tiff(size: [u32; 2], samples: u64, bits: u64, tile: Option<u64>) -> Vec<u8> {
    let mut image = Image::new(size, samples, bits, if samples == 1 { 1 } else { 2 });
    image.tag(259, SHORT, &[8]);
    let [w, h] = size.map(u64::from);
    match tile {
        None => image.strips(h, vec![deflated((w * samples * bits).div_ceil(8) * h, 90)]),
        Some(side) => {
            let one = deflated(side * side * samples * bits / 8, 90);
            image.tiles(
                [side, side],
                vec![one; (w.div_ceil(side) * h.div_ceil(side)) as usize],
            )
        }
    };
    Form::default().file(&[image])
}

fn write(dir: &tempfile::TempDir, k: usize, bytes: &[u8]) -> PathBuf {
    let path = dir.path().join(format!("{k}"));
    std::fs::write(&path, bytes).unwrap();
    path
}

/// Small files that claim much: read in grey they take next to nothing, in colour they are refused; profiles are not unpacked.
#[test]
fn twenty_bombs_stay_below_the_bound() {
    let dir = tempfile::tempdir().unwrap();
    let idat = |w: u64, h: u64, bits: u64| deflated((w * bits).div_ceil(8) * h + h, 0);
    let profile = [b"x\0\0", &deflated(200 << 20, 1)[..]].concat();
    let text = [b"x\0\0", &deflated(100 << 20, 1)[..]].concat();
    let bombs = [
        png([12_000, 12_000], 1, 0, false, &idat(12_000, 12_000, 1), &[]),
        png([12_000, 12_000], 1, 0, true, &idat(12_000, 14_000, 1), &[]),
        png([4000, 4000], 16, 6, false, &idat(4000, 4000, 64), &[]),
        png([4000, 4000], 16, 6, true, &idat(4000, 4400, 64), &[]),
        png([6000, 6000], 8, 2, false, &idat(6000, 6000, 24), &[]),
        png([2, 9_000_000], 8, 0, false, &idat(2, 9_000_000, 8), &[]),
        png(
            [64, 64],
            8,
            0,
            false,
            &idat(64, 64, 8),
            &[(b"iCCP", profile)],
        ),
        png([64, 64], 8, 0, false, &idat(64, 64, 8), &[(b"zTXt", text)]),
        png([u32::MAX >> 1, 2], 8, 2, false, &idat(64, 64, 8), &[]),
        png([60_000, 60_000], 8, 2, false, &idat(64, 64, 8), &[]),
        tiff([12_000, 12_000], 1, 8, None),
        tiff([6000, 6000], 3, 8, None),
        tiff([4000, 4000], 4, 16, None),
        tiff([12_000, 12_000], 1, 8, Some(1024)),
        tiff([9000, 9000], 1, 1, None),
        {
            // Tiles of a size that nobody makes, of which there is nothing.
            let mut image = Image::new([60_000, 60_000], 3, 8, 2);
            image.tiles([60_000, 60_000], vec![b"abc".to_vec()]);
            Form::default().file(&[image])
        },
        {
            let mut image = Image::new([u32::MAX, u32::MAX], 4, 16, 2);
            image
                .tag(259, SHORT, &[8])
                .strips(1 << 31, vec![b"abc".to_vec(); 2]);
            Form::default().file(&[image])
        },
        {
            // A tag that claims more values than the file has bytes.
            let mut file = tiff([64, 64], 1, 8, None);
            let n = file.len();
            for at in (0..n - 8).rev() {
                if file[at..at + 4] == [2, 1, 3, 0] {
                    file[at + 4..at + 8].copy_from_slice(&0x0fff_ffff_u32.to_le_bytes());
                    break;
                }
            }
            file
        },
        {
            let mut cut = jpeg([65_500, 16_000]);
            cut.truncate(20_000);
            cut.extend([0xff, 0xd9]);
            cut
        },
        jpeg([20_000, 6000]),
    ];
    assert_eq!(bombs.len(), 20);
    for (k, bomb) in bombs.iter().enumerate() {
        let path = write(&dir, k, bomb);
        let (peak, said) = child(&path, 48 * MB, "gray");
        assert!(
            peak < IDLE_KB + (48 << 10),
            "bomb {k} took {peak} kB: {said}"
        );
        if [8, 9, 15, 16, 18].contains(&k) {
            assert!(said.starts_with("error"), "{k}: {said}");
        }
    }
}

/// Pictures that are what they say: their mean is right, in grey and, where there is room, in colour.
#[test]
fn twelve_large_honest_pictures_stay_below_the_bound() {
    let dir = tempfile::tempdir().unwrap();
    let idat = |w: u64, h: u64, bytes: u64| {
        // A filter byte of 0 before each row.
        let row = [vec![0], vec![90; (w * bytes) as usize]].concat();
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::fast());
        (0..h).for_each(|_| encoder.write_all(&row).unwrap());
        encoder.finish().unwrap()
    };
    let pictures = [
        (
            png([6000, 5000], 8, 0, false, &idat(6000, 5000, 1), &[]),
            90.0 / 255.0,
        ),
        (
            png([5000, 4000], 8, 2, false, &idat(5000, 4000, 3), &[]),
            90.0 / 255.0,
        ),
        (
            png([4000, 3000], 16, 0, false, &idat(4000, 3000, 2), &[]),
            90.0 / 255.0,
        ),
        (
            png([4000, 3000], 16, 2, false, &idat(4000, 3000, 6), &[]),
            90.0 / 255.0,
        ),
        (tiff([6000, 5000], 1, 8, None), 90.0 / 255.0),
        (tiff([5000, 4000], 3, 8, None), 90.0 / 255.0),
        (tiff([4000, 3000], 3, 16, None), 90.0 / 255.0),
        (tiff([8000, 8000], 1, 8, Some(512)), 90.0 / 255.0),
        (tiff([6000, 6000], 3, 8, Some(256)), 90.0 / 255.0),
        (jpeg([12_000, 8000]), 0.0),
        (jpeg([4000, 3000]), 0.0),
        (
            {
                let mut image = Image::new([6000, 5000], 1, 8, 1);
                image.strips(100, vec![vec![90; 600_000]; 50]);
                Form::default().file(&[image])
            },
            90.0 / 255.0,
        ),
    ];
    assert_eq!(pictures.len(), 12);
    for (k, (file, mean)) in pictures.iter().enumerate() {
        let path = write(&dir, k, file);
        for way in ["gray", "rgb"] {
            let (peak, said) = child(&path, 80 * MB, way);
            assert!(peak < IDLE_KB + (80 << 10), "{k} took {peak} kB: {said}");
            let told: Option<f64> = said.strip_prefix("mean ").map(|m| m.parse().unwrap());
            match told {
                Some(told) if *mean > 0.0 => {
                    assert!((told - mean).abs() < 2e-3, "{k} {way}: {said}")
                }
                Some(told) => assert!((0.3..0.8).contains(&told), "{k} {way}: {said}"),
                None => assert!(
                    way == "rgb" && said.contains("MB of memory to read"),
                    "{k} {way}: {said}"
                ),
            }
        }
    }
}
