//! A tracker has all that it needs when it is made. The only test of this program: an allocator that counts is in it.

mod common;

use common::{Scene, placed};
use scopeservo_registration::tracking::Tracker;

#[test]
fn following_allocates_nothing() {
    let scene = Scene::random(1, 2500, 450.0, 1.5..12.0);
    let frame = |x: f64| {
        scene.frame(
            [640, 480],
            &placed(1.0, 0.0, [0.0; 2], [319.5 + x, 239.5]),
            0.01,
            3,
        )
    };
    let (first, second) = (frame(0.0), frame(7.3));
    let other = Scene::random(2, 2500, 450.0, 1.5..12.0).frame(
        [640, 480],
        &placed(1.0, 0.0, [0.0; 2], [319.5; 2]),
        0.01,
        3,
    );
    let made = allocation_counter::measure(|| {
        let _ = std::hint::black_box(Tracker::new(&first));
    });
    assert!(made.count_total > 0, "what counts does");
    let mut tracker = Tracker::new(&first).unwrap();
    let counted = allocation_counter::measure(|| {
        for _ in 0..5 {
            assert!(tracker.follow(&second).is_ok());
            assert!(tracker.follow(&other).is_err());
        }
    });
    assert_eq!(counted.count_total, 0);
}
