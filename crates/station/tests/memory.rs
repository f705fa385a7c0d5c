//! What a listener costs who never reads: alone in its process, as the process is what is measured.
#![cfg(target_os = "linux")]

use scopeservo_scope::{Channels, Frame, Samples, Timestamp};
use scopeservo_servo::{Event, FrameRole};
use scopeservo_station::{Bus, Heard, LOG_BYTES, News};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Resident memory of this process, bytes.
fn resident() -> usize {
    let text = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = text.lines().find(|l| l.starts_with("VmRSS:")).unwrap();
    let kib: usize = line.split_whitespace().nth(1).unwrap().parse().unwrap();
    kib << 10
}

fn frame(sequence: u64) -> Arc<Frame> {
    Arc::new(Frame {
        width: 640,
        height: 480,
        channels: Channels::Gray,
        bit_depth: 8,
        samples: Samples::U8(vec![sequence as u8; 640 * 480]),
        sequence,
        exposure_start: Timestamp::default(),
        exposure: Duration::from_millis(10),
    })
}

fn publish(bus: &Bus, event: u64) {
    let event = Event::FocusSample {
        z_um: event as f64,
        sharpness: 0.5,
    };
    bus.tell(News::Procedure(Box::new(event)));
}

#[test]
fn a_listener_that_never_reads_costs_nothing_over_a_hundred_thousand_frames_and_a_million_events() {
    // What the allocator needs for frames that come and go, and the lazy parts of the process.
    for k in 0..100 {
        drop(frame(k));
    }
    let (frames, events) = (100_000, 1_000_000);
    let before = resident();
    let bus = Bus::default();
    let kept = Arc::new(AtomicU64::new(0));
    let keeper = kept.clone();
    bus.keep(Arc::new(move |_| {
        keeper.fetch_add(1, Ordering::Relaxed);
    }));
    let mut never = bus.listen();
    let mut most = 0;
    for k in 0..events {
        publish(&bus, k);
        if k % (events / frames) == 0 {
            bus.show(&frame(k), FrameRole::Servo);
        }
        if k % 50_000 == 0 {
            most = most.max(resident().saturating_sub(before));
        }
    }
    most = most.max(resident().saturating_sub(before));
    assert!(most < 1_000_000, "grew by {most} bytes");
    // And when it reads after all it is told how much it missed; nothing is lost silently, and the keeper has had all.
    let Some(Heard::Missed { events: missed }) = never.heard() else {
        panic!("a million events do not fit");
    };
    let mut rest = 0;
    while let Some(Heard::Event(record)) = never.heard() {
        assert_eq!(record.number, missed + rest);
        rest += 1;
    }
    assert_eq!(missed + rest, events);
    assert_eq!(kept.load(Ordering::Relaxed), events);
    assert!(rest as usize > LOG_BYTES / 1024, "{rest}");
}
