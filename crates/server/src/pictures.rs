//! Pictures that people bring to the demonstration, to lie under its simulated microscope.

use crate::app::App;
use crate::error::ApiError;
use crate::lock;
use crate::people::Caller;
use axum::body::Body;
use axum::http::{HeaderMap, StatusCode, header};
use scopeservo_library::NewPicture;
use scopeservo_slide::{Slide, SlideError};
use scopeservo_workbench::LayError;
use serde_json::{Value, json};
use std::io::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::Duration;
use tokio::sync::SemaphorePermit;

/// No picture is larger, bytes.
pub(crate) const LARGEST: usize = 64 << 20;
/// So many come at the same time.
pub(crate) const COMING: usize = 2;

/// What is sent as a picture, and what a file of it is called.
const KINDS: [(&str, &str); 4] = [
    ("image/png", "png"),
    ("image/jpeg", "jpg"),
    ("image/tiff", "tif"),
    ("image/jp2", "jp2"),
];

/// The most pixels of one, which is held whole; and the shortest side: less is no specimen to come back to.
const MOST_PIXELS: u64 = 64_000_000;
const LEAST_SIDE: u32 = 256;
/// Looked at in so many pixels, to see that all of it can be decoded.
const LOOK: u64 = 1 << 18;

impl From<LayError> for ApiError {
    fn from(error: LayError) -> Self {
        match error {
            LayError::NoTwin => no_demo(),
            LayError::Unreadable { what } => bad_picture(what),
        }
    }
}

fn bad_picture(what: String) -> ApiError {
    ApiError::new(StatusCode::BAD_REQUEST, "bad_picture", what)
}

/// The size of a picture that can lie under the microscope, pixels. All of it was decoded, within the memory that the one reader may take.
fn size_of(path: &Path) -> Result<[u32; 2], ApiError> {
    // Where its file lies is nobody's business.
    let unreadable =
        |e: SlideError| bad_picture(e.to_string().replace(&path.display().to_string(), "it"));
    let slide = Slide::open(path).map_err(unreadable)?;
    let level = slide.levels()[0];
    let (width, height) = (level.width, level.height);
    let pixels = u64::from(width) * u64::from(height);
    if pixels > MOST_PIXELS || width.min(height) < LEAST_SIDE {
        return Err(bad_picture(format!(
            "it has {width} x {height} pixels: {LEAST_SIDE} each way are the least, and {MOST_PIXELS} together the most"
        )));
    }
    slide.read_gray_reduced(0, LOOK).map_err(unreadable)?;
    Ok([width, height])
}

fn no_demo() -> ApiError {
    let message = "pictures lie under a demonstration's microscope only: scopeservo serve --demo";
    ApiError::conflict("no_demo", message)
}

/// Whether there is a demonstration.
///
/// # Errors
/// `no_demo`.
pub(crate) fn is_demo(app: &App) -> Result<(), ApiError> {
    match (&app.demo, &app.bench.twin) {
        (Some(_), Some(_)) => Ok(()),
        _ => Err(no_demo()),
    }
}

/// The ending of a picture's file, by what it is said to be.
///
/// # Errors
/// `not_a_picture`.
pub(crate) fn ending(headers: &HeaderMap) -> Result<&'static str, ApiError> {
    let kind = headers
        .get(header::CONTENT_TYPE)
        .and_then(|kind| kind.to_str().ok());
    let known = KINDS
        .iter()
        .find(|(known, _)| kind.is_some_and(|kind| kind.eq_ignore_ascii_case(known)));
    known.map(|(_, ending)| *ending).ok_or_else(|| {
        let all = KINDS.map(|(kind, _)| kind).join(", ");
        let message = format!("a picture is sent with one of these as its content-type: {all}");
        ApiError::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "not_a_picture", message)
    })
}

/// A place among those that come; it is held until the picture is kept, so that no more are decoded at once either.
///
/// # Errors
/// `no_demo`, `too_many`.
pub(crate) fn place(app: &App) -> Result<SemaphorePermit<'_>, ApiError> {
    let demo = app.demo.as_ref().ok_or_else(no_demo)?;
    demo.coming.try_acquire().map_err(|_| {
        let message = "other pictures are coming: wait until they are there";
        ApiError::too_many(message, Duration::from_secs(5))
    })
}

/// What is sent, within bounds of size and time.
///
/// # Errors
/// `too_large`, `too_slow`.
pub(crate) async fn received(
    app: &App,
    headers: &HeaderMap,
    body: Body,
) -> Result<Vec<u8>, ApiError> {
    let demo = app.demo.as_ref().ok_or_else(no_demo)?;
    let too_large = || {
        let message = format!("a picture has {} MB at the most", LARGEST >> 20);
        ApiError::new(StatusCode::PAYLOAD_TOO_LARGE, "too_large", message)
    };
    let said = headers
        .get(header::CONTENT_LENGTH)
        .and_then(|length| length.to_str().ok()?.parse::<u64>().ok());
    if said.is_some_and(|length| length > LARGEST as u64) {
        return Err(too_large());
    }
    let all = axum::body::to_bytes(body, LARGEST);
    match tokio::time::timeout(demo.patience, all).await {
        Ok(Ok(bytes)) => Ok(bytes.into()),
        Ok(Err(_)) => Err(too_large()),
        Err(_) => {
            let s = demo.patience.as_secs_f64();
            let message = format!("the picture was not there within {s} s: send a smaller one");
            Err(ApiError::new(
                StatusCode::REQUEST_TIMEOUT,
                "too_slow",
                message,
            ))
        }
    }
}

/// Whether a picture of that name may come, before it does.
///
/// # Errors
/// `no_demo`, `bad_name`, `taken`, `too_many_pictures`, `bad_input`.
pub(crate) fn may_come(app: &App, name: &str, um_per_px: f64) -> Result<(), ApiError> {
    is_demo(app)?;
    if !(0.01..=50.0).contains(&um_per_px) {
        let message =
            "um_per_px, the size of the picture's pixels on the specimen, is from 0.01 to 50";
        return Err(ApiError::input(message));
    }
    Ok(app.bench.library.check_new_picture(name)?)
}

/// Keeps a picture that came, when all of it can be decoded.
///
/// # Errors
/// `bad_picture`, and as [`may_come`].
pub(crate) fn keep(
    app: &App,
    caller: &Caller,
    (name, um_per_px): (&str, f64),
    bytes: &[u8],
    ending: &str,
) -> Result<Value, ApiError> {
    may_come(app, name, um_per_px)?;
    let not_kept = |e: std::io::Error| {
        let message = format!("the picture could not be kept: {e}");
        ApiError::new(StatusCode::SERVICE_UNAVAILABLE, "not_kept", message)
    };
    let mut file = tempfile::NamedTempFile::new().map_err(not_kept)?;
    file.write_all(bytes).map_err(not_kept)?;
    let size_px = size_of(file.path())?;
    let new = NewPicture {
        name,
        um_per_px,
        size_px,
        user: &caller.user,
    };
    let row = app.bench.library.keep_picture(new, bytes, ending)?;
    app.audit
        .noted(caller, "brought a picture", json!({"picture": name}))?;
    app.has_changed();
    Ok(json!(row))
}

/// All of them, the newest first, and which lies under the microscope.
///
/// # Errors
/// `no_demo`, those of the library.
pub(crate) fn all(app: &App) -> Result<Value, ApiError> {
    is_demo(app)?;
    let lies = lies(app);
    let rows = app.bench.library.pictures()?;
    let told = rows.iter().map(|row| {
        let mut told = json!(row);
        told["lies"] = json!(lies.as_deref() == Some(&*row.name));
        told
    });
    Ok(told.collect())
}

/// The picture that lies under the microscope.
pub(crate) fn lies(app: &App) -> Option<String> {
    let demo = app.demo.as_ref()?;
    lock(&demo.picture).clone()
}

/// Deletes one that does not lie there.
///
/// # Errors
/// `no_demo`, `in_use`, `no_picture`.
pub(crate) fn remove(app: &App, caller: &Caller, name: &str) -> Result<(), ApiError> {
    is_demo(app)?;
    let demo = app.demo.as_ref().ok_or_else(no_demo)?;
    // Nobody lays it there meanwhile.
    let lies = lock(&demo.picture);
    if lies.as_deref() == Some(name) {
        let message = format!("'{name}' lies under the microscope: lay something else there first");
        return Err(ApiError::conflict("in_use", message));
    }
    app.bench.library.remove_picture(name)?;
    drop(lies);
    app.audit
        .noted(caller, "removed a picture", json!({"picture": name}))?;
    app.has_changed();
    Ok(())
}

/// Lays one under the microscope, or what lay there at first.
///
/// # Errors
/// `no_demo`, `no_picture`, `bad_picture`.
pub(crate) fn lay(app: &App, caller: &Caller, name: Option<&str>) -> Result<(), ApiError> {
    is_demo(app)?;
    let demo = app.demo.as_ref().ok_or_else(no_demo)?;
    let mut lies = lock(&demo.picture);
    match name {
        None => app.bench.lay(None)?,
        Some(name) => {
            let (row, path) = app.bench.library.picture(name)?;
            app.bench.lay(Some((&path, row.um_per_px)))?;
        }
    }
    *lies = name.map(str::to_owned);
    drop(lies);
    demo.is_moved.store(false, Ordering::SeqCst);
    // What is saved from now on lies on it.
    *lock(&app.slide) = name.map(str::to_owned);
    app.audit
        .noted(caller, "laid a picture", json!({"picture": name}))?;
    app.has_changed();
    Ok(())
}
