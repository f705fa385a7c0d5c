//! A client that leaves while a frame is exposed for it: the next one is let in at once, and its frame is its own.

use scopeservo_protocol::{Driver, DriverError, Offer, listen};
use scopeservo_scope::{
    Camera, CameraInfo, Channels, Clock, Devices, Frame, Samples, ScopeError, SystemClock,
};
use std::net::TcpListener;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// A camera whose frames are done when the test says so. It tells when one begins.
struct Held {
    info: CameraInfo,
    clock: Arc<dyn Clock>,
    begun: Mutex<Sender<u64>>,
    done: Mutex<Receiver<()>>,
    exposing: AtomicU64,
    sequence: AtomicU64,
}

impl Camera for Held {
    fn info(&self) -> &CameraInfo {
        &self.info
    }
    fn exposure(&self) -> Result<Duration, ScopeError> {
        Ok(self.info.max_exposure)
    }
    fn set_exposure(&self, _: Duration) -> Result<Duration, ScopeError> {
        self.exposure()
    }
    fn grab(&self) -> Result<Frame, ScopeError> {
        let others = self.exposing.fetch_add(1, Ordering::SeqCst);
        let sequence = self.sequence.fetch_add(1, Ordering::SeqCst);
        let exposure_start = self.clock.now();
        self.begun.lock().unwrap().send(sequence).unwrap();
        self.done.lock().unwrap().recv().unwrap();
        self.exposing.fetch_sub(1, Ordering::SeqCst);
        Ok(Frame {
            width: self.info.width,
            height: self.info.height,
            channels: self.info.channels,
            bit_depth: self.info.bit_depth,
            // How many others were being exposed.
            samples: Samples::U8(vec![others as u8; 4]),
            sequence,
            exposure_start,
            exposure: self.info.max_exposure,
        })
    }
}

#[test]
fn who_leaves_while_a_frame_is_exposed_makes_room_at_once() {
    let (begin, begun) = channel();
    let (finish, done) = channel();
    let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
    let camera = Held {
        info: CameraInfo {
            name: "held".into(),
            width: 2,
            height: 2,
            channels: Channels::Gray,
            bit_depth: 8,
            min_exposure: Duration::from_millis(1),
            max_exposure: Duration::from_millis(1),
        },
        clock: clock.clone(),
        begun: Mutex::new(begin),
        done: Mutex::new(done),
        exposing: AtomicU64::new(0),
        sequence: AtomicU64::new(0),
    };
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap().to_string();
    let offer = Offer {
        name: "held".into(),
        devices: Devices {
            camera: Some(Box::new(camera)),
            ..Devices::none(clock.clone())
        },
    };
    std::thread::spawn(move || listen(&listener, &offer, None, &|_| {}));
    let grab = |driver: &Driver| {
        let camera = driver.devices(&clock).unwrap().camera.unwrap();
        std::thread::spawn(move || camera.grab())
    };

    let first = Driver::connect(&address, None).unwrap();
    let lost = grab(&first);
    assert_eq!(begun.recv().unwrap(), 0);
    // While it is there nobody else is let in.
    let second = Driver::connect(&address, None).err();
    assert!(
        matches!(second, Some(DriverError::Taken { .. })),
        "{second:?}"
    );
    first.cut();
    assert!(lost.join().unwrap().is_err());
    // Its frame is still being exposed, and is until the next one has been let in and asks for its own.
    let next = Driver::connect(&address, None).unwrap();
    let own = grab(&next);
    // Only one at a time, the one that was left behind included.
    finish.send(()).unwrap();
    assert_eq!(begun.recv().unwrap(), 1);
    finish.send(()).unwrap();
    let frame = own.join().unwrap().unwrap();
    assert_eq!(frame.sequence, 1);
    assert_eq!(frame.samples, Samples::U8(vec![0; 4]));
    // And one place is free at a time, not two.
    let other = Driver::connect(&address, None).err();
    assert!(
        matches!(other, Some(DriverError::Taken { .. })),
        "{other:?}"
    );
}
