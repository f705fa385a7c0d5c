//! An engine keeps its buffers. From the second frame of a size on it allocates
//! - the result, and what it is put together from: extrema, and features by extremum; a few times the bytes of the result,
//! - the weights of the kernels and the lists of the bands: a few kilobytes for each octave,
//! - the histogram of the contrast, and what the thread pool needs to hand out work.
//!
//! No plane, no ring of rows, nothing else that grows with the image.

#![expect(
    unsafe_code,
    reason = "an allocator that counts is a trait with unsafe methods"
)]
#![expect(
    clippy::print_stdout,
    reason = "the measured bytes are worth reading with --nocapture"
)]

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

use common::Scene;
use scopeservo_sift::{Descriptor, Keypoint, Options, Sift, Simd};

/// The system's allocator, counting the bytes asked for.
struct Counting;

/// Bytes asked for, the greatest number at once, bytes in use and their peak.
static ASKED: AtomicUsize = AtomicUsize::new(0);
static GREATEST: AtomicUsize = AtomicUsize::new(0);
static USED: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn count(bytes: usize) {
    ASKED.fetch_add(bytes, Relaxed);
    GREATEST.fetch_max(bytes, Relaxed);
    let used = USED.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(used, Relaxed);
}

// SAFETY: every call is handed on as it is.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        USED.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        USED.fetch_sub(layout.size(), Relaxed);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// The only test of this binary: others would be counted, too.
#[test]
fn the_second_frame_of_a_size_allocates_no_buffer() {
    let scene = Scene::random(5, 3000, 900.0, 0.9..10.0);
    let frame = |dx: f64| scene.render(640, 480, |x, y| (x + 30.0 + dx, y + 50.0));
    let (first, second) = (frame(0.0), frame(7.3));
    let plane = 4 * 640 * 480;
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        for simd in Simd::available() {
            for first_octave in [-1, 0, 1] {
                let options = Options {
                    first_octave,
                    ..Options::default()
                };
                let mut sift = Sift::with(options, simd).unwrap();
                let mut frame = |image| {
                    pool.install(|| {
                        let used = USED.load(Relaxed);
                        PEAK.store(used, Relaxed);
                        ASKED.store(0, Relaxed);
                        GREATEST.store(0, Relaxed);
                        let features = sift.detect_and_describe(image);
                        let all = [ASKED.load(Relaxed), PEAK.load(Relaxed) - used];
                        (features, all, GREATEST.load(Relaxed))
                    })
                };
                let (_, before, _) = frame(&first);
                let (features, [asked, peak], greatest) = frame(&second);
                let result = features.len() * size_of::<(Keypoint, Descriptor)>();
                println!(
                    "{}, {threads} threads, from octave {first_octave}: {before:?} bytes, then {asked} in all, {peak} at once, {greatest} in one piece, for a result of {result}",
                    simd.level()
                );
                assert!(features.len() > 50, "{}", features.len());
                assert!(peak < 6 * result + (128 << 10), "{peak} for {result}");
                assert!(greatest < plane / 2, "{greatest}");
                assert!(peak < before[1] / 3, "{peak} after {before:?}");
            }
        }
    }
}
