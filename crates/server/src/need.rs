//! What a route needs of whoever asks, and whether that is met.

use crate::error::ApiError;
use crate::people::{Caller, Role};
use axum::http::StatusCode;

/// What a route needs of whoever asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    /// Nothing: how one comes in.
    Nobody,
    /// Somebody who may look, and stop.
    View,
    /// Somebody who may change what is kept.
    Operate,
    /// Somebody who may move the instrument, from where they are.
    Move,
    /// The same, at this computer.
    AllowElsewhere,
    /// Somebody who says who may.
    Administer,
}

impl Need {
    /// In a word.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Nobody => "nobody",
            Self::View => "viewer",
            Self::Operate => "operator",
            Self::Move => "operator, here",
            Self::AllowElsewhere => "operator, only here",
            Self::Administer => "admin",
        }
    }

    /// Whether that is met.
    ///
    /// # Errors
    /// `not_logged_in`, `role`, `not_here`.
    pub(crate) fn met_by(self, caller: Option<&Caller>) -> Result<(), ApiError> {
        let least = match self {
            Self::Nobody => return Ok(()),
            Self::View => Role::Viewer,
            Self::Operate | Self::Move | Self::AllowElsewhere => Role::Operator,
            Self::Administer => Role::Admin,
        };
        let Some(caller) = caller else {
            let message = "log in first";
            return Err(ApiError::new(
                StatusCode::UNAUTHORIZED,
                "not_logged_in",
                message,
            ));
        };
        if caller.role < least {
            let message = format!(
                "{} may look and stop; this needs the role {}",
                caller.user,
                match least {
                    Role::Admin => "admin",
                    _ => "operator",
                }
            );
            return Err(ApiError::forbidden("role", message));
        }
        let is_near = match self {
            Self::Move => caller.near,
            Self::AllowElsewhere => caller.here,
            _ => true,
        };
        if !is_near {
            let message =
                "from another machine nothing may be moved: allow it at the microscope first";
            return Err(ApiError::forbidden("not_here", message));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_role_does_what_it_may_and_what_the_lesser_ones_may() {
        let caller = |role, here| Caller {
            user: "anna".into(),
            role,
            key: String::new(),
            here,
            near: here,
        };
        let code = |need: Need, caller: Option<&Caller>| need.met_by(caller).err().map(|e| e.code);
        assert_eq!(code(Need::View, None).as_deref(), Some("not_logged_in"));
        let viewer = caller(Role::Viewer, true);
        assert_eq!(code(Need::View, Some(&viewer)), None);
        assert_eq!(code(Need::Move, Some(&viewer)).as_deref(), Some("role"));
        let far = caller(Role::Admin, false);
        assert_eq!(code(Need::Administer, Some(&far)), None);
        assert_eq!(code(Need::Move, Some(&far)).as_deref(), Some("not_here"));
        assert_eq!(code(Need::Move, Some(&caller(Role::Operator, true))), None);
    }
}
