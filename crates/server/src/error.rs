//! What is refused over the network: a status, a code and a kind for programs, and a sentence for people.

use axum::Json;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use scopeservo_library::LibraryError;
use scopeservo_scope::ScopeError;
use scopeservo_servo::{ErrorKind, ServoError};
use scopeservo_station::{JobError, Refusal};
use serde::Serialize;
use std::time::Duration;

/// The body of every answer that is none.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct ApiError {
    #[serde(skip)]
    pub(crate) status: StatusCode,
    /// Stable, for programs.
    pub(crate) code: String,
    /// `input`, `refusal`, `fault`, `interruption` or `answer`.
    pub(crate) kind: &'static str,
    /// What it is and what to do, for people.
    pub(crate) message: String,
    /// When it may be asked again.
    #[serde(skip)]
    pub(crate) retry_after: Option<Duration>,
}

impl ApiError {
    pub(crate) fn new(status: StatusCode, code: &str, message: impl Into<String>) -> Self {
        let kind = match status {
            StatusCode::INTERNAL_SERVER_ERROR | StatusCode::SERVICE_UNAVAILABLE => "fault",
            StatusCode::BAD_REQUEST
            | StatusCode::UNPROCESSABLE_ENTITY
            | StatusCode::UNSUPPORTED_MEDIA_TYPE
            | StatusCode::PAYLOAD_TOO_LARGE => "input",
            _ => "refusal",
        };
        Self {
            status,
            code: code.into(),
            kind,
            message: message.into(),
            retry_after: None,
        }
    }

    /// What a killed program left comes first.
    pub(crate) fn unfinished(left: &str) -> Self {
        let message = format!("{left}. Resume it or abandon it first");
        Self::conflict("unfinished", message)
    }

    /// Whoever asks is to wait.
    pub(crate) fn too_many(message: impl Into<String>, wait: Duration) -> Self {
        Self {
            retry_after: Some(wait),
            ..Self::new(StatusCode::TOO_MANY_REQUESTS, "too_many", message)
        }
    }

    /// What was sent makes no sense.
    pub(crate) fn input(message: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, "bad_input", message)
    }

    /// There is no such thing.
    pub(crate) fn missing(message: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", message)
    }

    /// It cannot be done as things are.
    pub(crate) fn conflict(code: &str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::CONFLICT, code, message)
    }

    /// Not for whoever asks.
    pub(crate) fn forbidden(code: &str, message: impl Into<String>) -> Self {
        Self::new(StatusCode::FORBIDDEN, code, message)
    }

    /// A mistake of ours, or of the system.
    pub(crate) fn fault(message: impl Into<String>) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", message)
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let wait = self.retry_after;
        let mut response = (self.status, Json(self)).into_response();
        if let Some(wait) = wait {
            // Whole seconds, and not one too few.
            let seconds = HeaderValue::from(wait.as_secs_f64().ceil() as u64);
            response.headers_mut().insert(header::RETRY_AFTER, seconds);
        }
        response
    }
}

/// A refusal is a conflict with how things stand; a fault is the instrument's.
fn status_of(kind: ErrorKind) -> (StatusCode, &'static str) {
    match kind {
        ErrorKind::Answer => (StatusCode::CONFLICT, "answer"),
        ErrorKind::Refusal => (StatusCode::CONFLICT, "refusal"),
        ErrorKind::Interruption => (StatusCode::CONFLICT, "interruption"),
        ErrorKind::Fault => (StatusCode::SERVICE_UNAVAILABLE, "fault"),
    }
}

impl From<ServoError> for ApiError {
    fn from(error: ServoError) -> Self {
        let (status, kind) = status_of(error.kind());
        let code = serde_json::to_value(error.code()).ok();
        let code = code.and_then(|code| code.as_str().map(str::to_owned));
        Self {
            status,
            code: code.unwrap_or_else(|| "failed".into()),
            kind,
            message: error.to_string(),
            retry_after: None,
        }
    }
}

impl From<ScopeError> for ApiError {
    fn from(error: ScopeError) -> Self {
        ServoError::from(error).into()
    }
}

impl From<JobError> for ApiError {
    fn from(error: JobError) -> Self {
        let (status, kind) = status_of(error.kind());
        let code = match &error {
            JobError::Procedure(_) => None,
            JobError::Stopped { .. } => Some("stopped"),
            JobError::NoObjective { .. } => Some("no_objective"),
            JobError::Journal(_) => Some("not_kept"),
            _ => Some("internal"),
        };
        match (error, code) {
            (JobError::Procedure(error), _) => error.into(),
            (error, code) => Self {
                status,
                code: code.unwrap_or("failed").into(),
                kind,
                message: error.to_string(),
                retry_after: None,
            },
        }
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        let (status, code) = match &refusal {
            Refusal::Held { .. } => (StatusCode::CONFLICT, "held"),
            Refusal::LeaseLost { .. } => (StatusCode::CONFLICT, "lease_lost"),
            Refusal::NoSuchJob { .. } => (StatusCode::NOT_FOUND, "no_such_job"),
            Refusal::NoSuchQuestion { .. } => (StatusCode::NOT_FOUND, "no_such_question"),
            _ => (StatusCode::SERVICE_UNAVAILABLE, "no_thread"),
        };
        Self::new(status, code, refusal.to_string())
    }
}

impl From<LibraryError> for ApiError {
    fn from(error: LibraryError) -> Self {
        let (status, code) = match &error {
            LibraryError::BadName(_) => (StatusCode::BAD_REQUEST, "bad_name"),
            LibraryError::Taken { .. } => (StatusCode::CONFLICT, "taken"),
            LibraryError::InUse { .. } => (StatusCode::CONFLICT, "in_use"),
            LibraryError::NoTarget { .. } | LibraryError::NoTargetNumbered { .. } => {
                (StatusCode::NOT_FOUND, "no_target")
            }
            LibraryError::NotInBin { .. } => (StatusCode::NOT_FOUND, "not_in_bin"),
            LibraryError::NoPicture { .. } => (StatusCode::NOT_FOUND, "no_picture"),
            LibraryError::TooManyPictures { .. } => (StatusCode::CONFLICT, "too_many_pictures"),
            LibraryError::NoRun { .. } => (StatusCode::NOT_FOUND, "no_run"),
            LibraryError::Busy { .. } => (StatusCode::SERVICE_UNAVAILABLE, "busy"),
            LibraryError::CannotWrite { .. } | LibraryError::NotKept { .. } => {
                (StatusCode::SERVICE_UNAVAILABLE, "not_kept")
            }
            LibraryError::Damaged { .. }
            | LibraryError::DamagedCalibration { .. }
            | LibraryError::DamagedJournal { .. } => (StatusCode::CONFLICT, "damaged"),
            _ => (StatusCode::SERVICE_UNAVAILABLE, "cannot_read"),
        };
        Self::new(status, code, error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_keeps_its_code_and_its_sentence() {
        let held = ApiError::from(Refusal::Held {
            owner: "anna".into(),
            seconds_left: None,
        });
        assert_eq!(
            (held.status, held.code.as_str()),
            (StatusCode::CONFLICT, "held")
        );
        assert!(held.message.contains("anna"), "{}", held.message);
        let homed = ApiError::from(ScopeError::NotHomed { device: "stage" });
        assert_eq!((homed.kind, homed.code.as_str()), ("refusal", "refused"));
    }
}
