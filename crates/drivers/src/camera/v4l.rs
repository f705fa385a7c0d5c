//! Video devices of this machine (V4L2), through the crate `linuxvideo`.

use crate::camera::exposing::Exposing;
use crate::camera::raw::{Layout, PixelOrder};
use crate::camera::stream::{Packed, Source, StreamCamera};
use crate::camera::v4l_settings::{PixelFormat, V4lSettings};
use crate::camera::{bad_setting, device, duration, lost};
use crate::session::lock;
use linuxvideo::controls::Cid;
use linuxvideo::format::{FrameSizes, PixFormat, PixelFormat as Code};
use linuxvideo::stream::ReadStream;
use linuxvideo::{BufType, CapabilityFlags, Device};
use scopeservo_scope::{Clock, ScopeError};
use std::fmt::Display;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// How often it is asked whether an image has come.
const ASK: Duration = Duration::from_millis(2);
/// The exposure is counted in units of 0.1 ms.
const EXPOSURE_UNIT_S: f64 = 1e-4;
/// The value of `EXPOSURE_AUTO` for an exposure that stays as it is set.
const MANUAL: i32 = 1;

/// Opens the device and waits for its first image.
///
/// # Errors
/// [`ScopeError::BadSetting`] for a size or format that it does not have, [`ScopeError::Lost`] when it is not there or in use,
/// [`ScopeError::Timeout`], [`ScopeError::Device`].
pub fn v4l_camera(
    settings: &V4lSettings,
    clock: Arc<dyn Clock>,
) -> Result<StreamCamera, ScopeError> {
    let latency = duration("latency_ms", settings.latency_ms)?;
    let timeout = duration("timeout_ms", settings.timeout_ms)?;
    let there = open(&settings.device)?;
    let card = there.capabilities().map_err(|e| lost(e.to_string()))?;
    let name = format!("{} at {}", card.card(), settings.device.display());
    let exposing = exposing(there, settings)?;
    let again = settings.clone();
    let open = move || Ok(Box::new(Video::open(&again)?) as Box<dyn Source>);
    StreamCamera::new(name, Box::new(open), exposing, latency, timeout, clock)
}

fn open(path: &Path) -> Result<Device, ScopeError> {
    let bad = |what: &dyn Display| lost(format!("{}: {what}", path.display()));
    let there = Device::open(path).map_err(|e| bad(&e))?;
    let can = there.capabilities().map_err(|e| bad(&e))?;
    let can = can.device_capabilities();
    if !can.contains(CapabilityFlags::VIDEO_CAPTURE) {
        return Err(bad(
            &"the device gives no images: many cameras have several devices, of which the first gives them",
        ));
    }
    Ok(there)
}

/// The exposure of a device that has one, set to stay as it is.
fn exposing(mut there: Device, settings: &V4lSettings) -> Result<Exposing, ScopeError> {
    let found = there
        .controls()
        .filter_map(Result::ok)
        .find(|c| c.id() == Cid::EXPOSURE_ABSOLUTE);
    let at = settings.device.display();
    let Some(control) = found else {
        let ms = settings.fixed_exposure_ms.ok_or_else(|| {
            bad_setting(format!(
                "the exposure of {at} cannot be set: say with fixed_exposure_ms how long it exposes"
            ))
        })?;
        return Ok(Exposing::fixed(duration("fixed_exposure_ms", ms)?));
    };
    if settings.fixed_exposure_ms.is_some() {
        return Err(bad_setting(format!(
            "the exposure of {at} can be set: leave out fixed_exposure_ms"
        )));
    }
    let time = |units: i32| Duration::from_secs_f64(f64::from(units.max(1)) * EXPOSURE_UNIT_S);
    let fault = |e: std::io::Error| device(format!("its exposure: {e}"));
    let automatic = there
        .controls()
        .filter_map(Result::ok)
        .any(|c| c.id() == Cid::EXPOSURE_AUTO);
    if automatic {
        let off = there.write_control_raw(Cid::EXPOSURE_AUTO, MANUAL);
        off.map_err(|e| device(format!("automatic exposure cannot be switched off: {e}")))?;
    }
    let now = time(there.read_control_raw(control.id()).map_err(fault)?);
    let range = [time(control.minimum()), time(control.maximum())];
    let there = Mutex::new(there);
    let set = move |exposure: Duration| {
        let mut there = lock(&there);
        let units = (exposure.as_secs_f64() / EXPOSURE_UNIT_S).round() as i32;
        there
            .write_control_raw(Cid::EXPOSURE_ABSOLUTE, units)
            .map_err(fault)?;
        let set = there.read_control_raw(Cid::EXPOSURE_ABSOLUTE);
        Ok(time(set.map_err(fault)?))
    };
    Ok(Exposing::with(now, range, Box::new(set)))
}

fn code(format: PixelFormat) -> Code {
    Code::from_fourcc(*match format {
        PixelFormat::Mjpg => b"MJPG",
        PixelFormat::Yuyv => b"YUYV",
        PixelFormat::Uyvy => b"UYVY",
        PixelFormat::Nv12 => b"NV12",
        PixelFormat::Rgb3 => b"RGB3",
        PixelFormat::Bgr3 => b"BGR3",
        PixelFormat::Grey => b"GREY",
        PixelFormat::Y10 => b"Y10 ",
        PixelFormat::Y12 => b"Y12 ",
        PixelFormat::Y16 => b"Y16 ",
    })
}

/// `None`: files, not pixels.
fn order(format: PixelFormat) -> Option<PixelOrder> {
    Some(match format {
        PixelFormat::Mjpg => return None,
        PixelFormat::Yuyv => PixelOrder::Yuyv,
        PixelFormat::Uyvy => PixelOrder::Uyvy,
        PixelFormat::Nv12 => PixelOrder::Nv12,
        PixelFormat::Rgb3 => PixelOrder::Rgb,
        PixelFormat::Bgr3 => PixelOrder::Bgr,
        PixelFormat::Grey => PixelOrder::Gray,
        PixelFormat::Y10 => PixelOrder::Gray16 { bits: 10 },
        PixelFormat::Y12 => PixelOrder::Gray16 { bits: 12 },
        PixelFormat::Y16 => PixelOrder::Gray16 { bits: 16 },
    })
}

/// What a device has, for people.
fn offered(there: &Device) -> String {
    let sizes = |code| match there.frame_sizes(code) {
        Ok(FrameSizes::Discrete(sizes)) => {
            let sizes = sizes
                .into_iter()
                .map(|s| format!("{}x{}", s.width(), s.height()));
            sizes.collect::<Vec<_>>().join(" ")
        }
        Ok(_) => "any size".into(),
        Err(_) => String::new(),
    };
    let formats = there.formats(BufType::VIDEO_CAPTURE);
    let formats = formats.filter_map(Result::ok).map(|f| {
        let code = f.pixel_format();
        format!("{} {}", code.to_string().to_lowercase(), sizes(code))
    });
    formats.collect::<Vec<_>>().join("; ")
}

/// A device that sends.
struct Video {
    stream: ReadStream,
    layout: Option<Layout>,
}

impl Video {
    fn open(settings: &V4lSettings) -> Result<Self, ScopeError> {
        let there = open(&settings.device)?;
        let at = |what: &dyn Display| lost(format!("{}: {what}", settings.device.display()));
        let offered = offered(&there);
        let (width, height) = (settings.width_px, settings.height_px);
        let asked = PixFormat::new(width, height, code(settings.format));
        let capture = there.video_capture(asked).map_err(|e| at(&e))?;
        let set = capture.format();
        if (set.width(), set.height(), set.pixel_format()) != (width, height, code(settings.format))
        {
            return Err(bad_setting(format!(
                "{} has no {} x {} in the format {}; it has {offered}",
                settings.device.display(),
                width,
                height,
                code(settings.format).to_string().to_lowercase(),
            )));
        }
        let layout = order(settings.format).map(|order| Layout {
            order,
            width: width as usize,
            height: height as usize,
            row_bytes: set.bytes_per_line() as usize,
        });
        let stream = capture.into_stream().map_err(|e| at(&e))?;
        Ok(Self { stream, layout })
    }
}

impl Source for Video {
    fn next(&mut self, wait: Duration) -> Result<Option<(Packed, Instant)>, String> {
        let give_up = Instant::now() + wait;
        while self.stream.will_block().map_err(|e| e.to_string())? {
            if Instant::now() >= give_up {
                return Ok(None);
            }
            std::thread::sleep(ASK);
        }
        let layout = self.layout;
        let picture = self.stream.dequeue(|bytes| {
            Ok((!bytes.is_error()).then(|| match layout {
                Some(layout) => Packed::Raw(layout, bytes.to_vec()),
                None => Packed::File(bytes.to_vec()),
            }))
        });
        let picture = picture.map_err(|e| e.to_string())?;
        Ok(picture.map(|packed| (packed, Instant::now())))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use scopeservo_scope::{Camera, SystemClock};

    fn settings(device: &str) -> V4lSettings {
        V4lSettings {
            device: device.into(),
            width_px: 640,
            height_px: 480,
            format: PixelFormat::Yuyv,
            latency_ms: 150.0,
            timeout_ms: 3000.0,
            fixed_exposure_ms: None,
        }
    }

    #[test]
    fn what_is_no_camera_is_told() {
        for wrong in ["/dev/null", "/nowhere/video0"] {
            let answer = v4l_camera(&settings(wrong), Arc::new(SystemClock::new()));
            let error = answer.err().unwrap();
            assert!(matches!(error, ScopeError::Lost { .. }), "{error}");
            assert!(error.to_string().contains(wrong), "{error}");
        }
    }

    /// Against a real device, where `SCOPESERVO_VIDEO_DEVICE` names one that has 640 x 480 in yuyv, such as that of the kernel's
    /// `vivid`.
    #[test]
    #[ignore = "needs a video device: SCOPESERVO_VIDEO_DEVICE"]
    fn a_video_device_gives_fresh_pictures() {
        let path = std::env::var("SCOPESERVO_VIDEO_DEVICE").unwrap();
        let mut settings = settings(&path);
        let clock = Arc::new(SystemClock::new());
        let camera = match v4l_camera(&settings, clock.clone()) {
            Ok(camera) => camera,
            Err(_) => {
                settings.fixed_exposure_ms = Some(20.0);
                v4l_camera(&settings, clock.clone()).unwrap()
            }
        };
        let mut last = None;
        for _ in 0..5 {
            let asked = clock.now();
            let frame = camera.grab().unwrap();
            assert!(frame.exposure_start >= asked && Some(frame.sequence) > last);
            assert_eq!((frame.width, frame.height), (640, 480));
            last = Some(frame.sequence);
        }
    }
}
