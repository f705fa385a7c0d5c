//! What can stop a procedure.

use crate::words::{astray_in_words, pitch_in_words, rival_in_words, way_in_words};
use scopeservo_features::FeatureError;
use scopeservo_registration::{NoGrid, NotFound, Rival};
use scopeservo_scope::{Axis, ObjectiveId, ScopeError};
use thiserror::Error;

/// The error of every procedure.
#[derive(Debug, Clone, Error)]
#[non_exhaustive]
pub enum ServoError {
    /// The instrument refused, failed or was stopped.
    #[error(transparent)]
    Scope(#[from] ScopeError),
    /// A frame could not be turned into features.
    #[error("the frame could not be used: {0}")]
    Features(#[from] FeatureError),
    /// The sharpness has no peak within the sweep.
    #[error(
        "no focus found with {objective}: sharpness varies by a factor of {contrast:.2} over {from_um:.0} to {to_um:.0} um \
         without a peak. Move to a place with tissue, or nearer to focus, and try again"
    )]
    NoFocus {
        /// The active objective.
        objective: ObjectiveId,
        /// Largest over smallest sharpness of the sweep.
        contrast: f64,
        /// Lower end of the sweep.
        from_um: f64,
        /// Upper end of the sweep.
        to_um: f64,
    },
    /// It gets sharper towards where the stage may not go.
    #[error(
        "the focus of {objective} lies beyond where the stage may go: it gets sharper towards an end of {from_um:.0} to {to_um:.0} um. \
         Give a wider range, or move nearer to focus by hand"
    )]
    FocusAtLimit {
        /// The active objective.
        objective: ObjectiveId,
        /// Lower end of the sweep.
        from_um: f64,
        /// Upper end of the sweep.
        to_um: f64,
    },
    /// Too few of the calibration views could be registered.
    #[error(
        "calibration of {objective} failed: {measured} of {needed} moves could be measured; the last view was not found \
         because of {last}. Calibrate over a place with more tissue"
    )]
    CalibrationViews {
        /// The active objective.
        objective: ObjectiveId,
        /// Moves measured.
        measured: usize,
        /// Moves needed.
        needed: usize,
        /// Why the last view was not found.
        last: NotFound,
    },
    /// The calibration contradicts the data sheet or the camera.
    #[error(
        "calibration of {objective} was refused: it gives {measured_um_per_px:.3} um per pixel where {nominal_um_per_px:.3} \
         is engraved. Check which objective is active and the units of the stage"
    )]
    CalibrationImplausible {
        /// The active objective.
        objective: ObjectiveId,
        /// What was measured.
        measured_um_per_px: f64,
        /// What the instrument states.
        nominal_um_per_px: f64,
    },
    /// What was seen does not fit what the stage says it did.
    #[error(
        "calibration of {objective} was refused: what was seen is {residual_px:.1} px off what the stage reported, and \
         {allowed_px:.1} px would be its repeatability. Look for lost steps, backlash or a slipping slide"
    )]
    CalibrationInconsistent {
        /// The active objective.
        objective: ObjectiveId,
        /// Root mean square residual, px.
        residual_px: f64,
        /// What would have been accepted, px.
        allowed_px: f64,
    },
    /// There is nothing to calibrate on.
    #[error(
        "calibration of {objective} failed: the field is blank, with {features} features where {needed} are needed. Focus, and go to a place with \
         tissue"
    )]
    BlankView {
        /// The active objective.
        objective: ObjectiveId,
        /// The most that a view had.
        features: usize,
        /// Needed.
        needed: usize,
    },
    /// The image went dark on the way.
    #[error(
        "calibration of {objective} was broken off: the image went dark after {views} views. Look at the lamp, the shutter and the camera"
    )]
    WentDark {
        /// The active objective.
        objective: ObjectiveId,
        /// Views before.
        views: usize,
    },
    /// An axis was moved, and the image stayed.
    #[error(
        "calibration of {objective} was refused: {axis} was sent {}, and the image did not follow: {axis} stands, or all that is seen is on the \
         camera. Look whether it is switched on, free and not held, that the slide lies on it, and at its unit: a thousandth of a move looks like none",
        way_in_words(*axis, *asked)
    )]
    AxisStands {
        /// The active objective.
        objective: ObjectiveId,
        /// The axis.
        axis: Axis,
        /// How far it was sent, m or rad.
        asked: f64,
    },
    /// x and y move the image the same way.
    #[error(
        "calibration of {objective} was refused: x and y move the image along the same direction. One of them does the other's work: look at \
         the cables and at how the axes are assigned"
    )]
    AxesAlike {
        /// The active objective.
        objective: ObjectiveId,
    },
    /// The image turns to the other side than x and y tell.
    #[error(
        "calibration of {objective} was refused: the image turns to the other side than x and y tell. Two axes are swapped, or one of them has \
         the wrong sign, or what the stage carries is described the wrong way round"
    )]
    AxesContradict {
        /// The active objective.
        objective: ObjectiveId,
    },
    /// Pixels are much longer one way than the other.
    #[error(
        "calibration of {objective} was refused: a pixel is {factor:.2} times as long one way as the other. One of x and y goes another distance \
         than it says: look at its steps per millimetre"
    )]
    AxesDiffer {
        /// The active objective.
        objective: ObjectiveId,
        /// The longer over the shorter.
        factor: f64,
    },
    /// The view is not where the stage and all other views put it.
    #[error(
        "calibration of {objective} was refused: {}. The stage lost steps, an axis stopped, the slide slipped, or something was moved by hand \
         meanwhile",
        astray_in_words(*off_um)
    )]
    ViewAstray {
        /// The active objective.
        objective: ObjectiveId,
        /// How far; `None` where it was not found again.
        off_um: Option<f64>,
    },
    /// The view moves while the stage stands.
    #[error(
        "calibration of {objective} was refused: the view shakes by {um:.1} um while the stage stands. Look for what shakes the table or the \
         microscope, for a loose slide or camera, and for a stage that does not come to rest"
    )]
    ViewShakes {
        /// The active objective.
        objective: ObjectiveId,
        /// Standard deviation, um.
        um: f64,
    },
    /// Two objectives of one microscope contradict each other.
    #[error(
        "calibration of {objective} was not kept: it contradicts that of {other}: {what}. {}",
        wrong.as_ref().map_or(
            "One of the two is wrong: calibrate both again, with a third where there is one".to_owned(),
            |id| format!("{id} is the one that disagrees: look whether it is in the beam as said, and calibrate it again")
        )
    )]
    ObjectivesDisagree {
        /// The objective that was calibrated.
        objective: ObjectiveId,
        /// The one it contradicts.
        other: ObjectiveId,
        /// In what.
        what: String,
        /// Which of all is wrong, where the others tell.
        wrong: Option<ObjectiveId>,
    },
    /// Rotations did not show the rotation centre.
    #[error(
        "calibration of {objective} failed: the rotation centre is known to {sigma_mm:.0} mm only, as the views that turn were not found. \
         Calibrate where there is tissue all round, away from the limits: rotations need room"
    )]
    CentreUnknown {
        /// The active objective.
        objective: ObjectiveId,
        /// Standard deviation, mm.
        sigma_mm: f64,
    },
    /// Views contradict each other.
    #[error(
        "calibration of {objective} was refused: {left_out} of {pairs} pairs of views contradict the others. Look for a slide that slips, for \
         vibration, and for a specimen that repeats itself"
    )]
    CalibrationContradicted {
        /// The active objective.
        objective: ObjectiveId,
        /// Pairs that others contradict.
        left_out: usize,
        /// All pairs.
        pairs: usize,
    },
    /// Which objective is active could not be seen.
    #[error(
        "whether {objective} is active could not be seen, because of {reason}. Go to a place with tissue, in focus, and try again"
    )]
    ObjectiveUnclear {
        /// The objective that is said to be there.
        objective: ObjectiveId,
        /// Why the view was not found after a small move.
        reason: NotFound,
    },
    /// The image does not move with the stage.
    #[error(
        "whether {objective} is active could not be seen: the stage moved by {moved_um:.1} um, and all that is seen stayed. Where this is dust move to \
         tissue; else look whether the objective has clicked in, the slide is held, and the stage's unit: a thousandth of a move looks like none"
    )]
    PictureStays {
        /// The objective that is said to be there.
        objective: ObjectiveId,
        /// How far the stage moved.
        moved_um: f64,
    },
    /// A step went much farther than it was asked to.
    #[error(
        "the stage was asked to go {asked_um:.3} um, and {}: it goes much farther than it says, so look at its unit and its steps per \
         millimetre before it moves again",
        seen_px.map_or("the view was gone".to_owned(), |px| format!("the image shifted by {px:.0} pixels"))
    )]
    MovesTooFar {
        /// The step that was asked for.
        asked_um: f64,
        /// How far the image went; `None` when it was not found again.
        seen_px: Option<f64>,
    },
    /// Two images of one place have too little in common to tell whether it moves.
    #[error(
        "two images of one place have too little in common to tell whether the view moves: put in a specimen with structure, in focus"
    )]
    NothingToFollow,
    /// The stage scatters too much for a move that stays in the field.
    #[error(
        "whether {objective} is active could not be told: the stage arrives to within {scatter_um:.1} um, and a move of \
         {moved_um:.1} um is the longest that stays in the field. Look yourself, and describe one objective \
         alone if it must do without"
    )]
    StageTooCoarse {
        /// The objective that is said to be there.
        objective: ObjectiveId,
        /// How far the stage moved.
        moved_um: f64,
        /// Half-width of its arrivals.
        scatter_um: f64,
    },
    /// The image shows another objective than the one that is said to be there.
    #[error(
        "{told} was asked for, but the image has {um_per_px:.3} um per pixel, {}: nothing was done with it. Bring {told} into the \
         beam, or correct the scales of the objectives",
        looks_like.as_ref().map_or("which fits no objective".into(), |o| format!("as {o} has"))
    )]
    WrongObjective {
        /// The objective that is said to be there.
        told: ObjectiveId,
        /// The one that it looks like.
        looks_like: Option<ObjectiveId>,
        /// What was measured.
        um_per_px: f64,
    },
    /// A view that could not be recognised again.
    #[error(
        "this view has {features} features{}, and could not be recognised: {needed} are needed. Focus, or choose a place with more \
         tissue; nothing was saved",
        moved.map_or(String::new(), |m| format!(", {m} of which were seen to move with the stage"))
    )]
    PoorTarget {
        /// Features of the view.
        features: usize,
        /// Those that were seen to move with the stage, when that was looked at.
        moved: Option<usize>,
        /// Needed.
        needed: usize,
    },
    /// What the view shows is too little to be found again.
    #[error("this view {0}; nothing was saved")]
    HopelessTarget(Box<crate::TargetQuality>),
    /// The stage moved, and nothing in the image did.
    #[error(
        "the stage moved by {moved_um:.1} um with {objective}, and nothing of the {features} features in the image moved with it: it is stuck, or \
         all of it is on the camera (dust, a reticle, burnt-in text); nothing was saved. Go to a place with tissue, or clean the camera"
    )]
    NothingMoves {
        /// The active objective.
        objective: ObjectiveId,
        /// How far the stage moved.
        moved_um: f64,
        /// Features of the view.
        features: usize,
    },
    /// The view repeats itself.
    #[error(
        "this view looks the same {} away: whether a view is this place or that one could not be told, and nothing was saved. Choose a place \
         with something that is there only once, a defect or an edge, or a lower magnification",
        rival_in_words(rival, *um_per_px)
    )]
    Repeats {
        /// The other place.
        rival: Rival,
        /// Size of a pixel, um, if known.
        um_per_px: Option<f64>,
    },
    /// No grid that could be measured with.
    #[error(
        "no grid of {pitch_um} um was seen with {objective}: {why}{}", pitch_in_words(why, *pitch_um, *um_per_px)
    )]
    NoGrid {
        /// The active objective.
        objective: ObjectiveId,
        /// The pitch that was told, um.
        pitch_um: f64,
        /// The nominal size of a pixel, um.
        um_per_px: f64,
        /// Why.
        why: NoGrid,
    },
    /// The stage scatters so much that it could not be told by how many periods it moved.
    #[error(
        "the stage arrives to within {scatter_um:.2} um, and on a grid of {pitch_um} um it could not be told how many periods it went: \
         take a coarser grid, and an objective that shows it"
    )]
    GridTooFineForStage {
        /// The pitch, um.
        pitch_um: f64,
        /// Standard deviation of its arrivals, um.
        scatter_um: f64,
    },
    /// The grid was not seen again after the stage had moved.
    #[error(
        "the grid could be followed in {followed} of {views} views with {objective}{}. See that the grid is large enough, level and held",
        why.map_or(String::new(), |why| format!(", the last time because {why}"))
    )]
    GridUnfollowed {
        /// The active objective.
        objective: ObjectiveId,
        /// Views in which it was.
        followed: usize,
        /// All views.
        views: usize,
        /// Why not in the last one that was lost; `None` where it may have been a period off.
        why: Option<NoGrid>,
    },
    /// The stage does not go where it says.
    #[error(
        "the stage does not go where it says: by the grid it goes {:.1} % wrong, and views lie {residual_px:.1} px off where {allowed_px:.1} px \
         would be its repeatability. Is the pitch {pitch_um} um? Else look at its unit and its steps per millimetre, and for lost steps or a \
         slipping slide",
        100.0 * stretch
    )]
    GridStage {
        /// The active objective.
        objective: ObjectiveId,
        /// The pitch that was told, um.
        pitch_um: f64,
        /// Root mean square residual, px.
        residual_px: f64,
        /// What would have been accepted, px.
        allowed_px: f64,
        /// How much farther than it says, or less far, relative: the larger of x and y.
        stretch: f64,
    },
    /// Whether a calibration still holds could not be seen.
    #[error(
        "whether the calibration of {objective} still holds could not be seen, because of {reason}. Focus, go to a place with tissue, and check \
         again"
    )]
    CheckUnclear {
        /// The active objective.
        objective: ObjectiveId,
        /// Why a view was not found again.
        reason: NotFound,
    },
    /// Arrivals of two objectives that come in turn were not found in one view.
    #[error(
        "how well {to} comes back after {from} could not be seen, because of {reason}. Focus, go to a place with tissue, and try again"
    )]
    SwitchingUnclear {
        /// The objective whose view is the wider one.
        from: ObjectiveId,
        /// The other one.
        to: ObjectiveId,
        /// Why a view was not found.
        reason: NotFound,
    },
    /// The stage scatters so much that nothing can be said of a calibration.
    #[error(
        "whether the calibration of {objective} still holds could not be told: by these moves its scale is known to {sigma_percent:.1} % only, as \
         the stage's arrivals scatter. Calibrate instead, which takes more views"
    )]
    CheckTooCoarse {
        /// The active objective.
        objective: ObjectiveId,
        /// Standard deviation, percent.
        sigma_percent: f64,
    },
    /// An axis was moved to check a calibration, and the image stayed.
    #[error(
        "{axis} was sent {} with {objective} to check its calibration, and the image did not follow: {axis} stands, or all that is seen is on the \
         camera. Look whether it is switched on and free, and that the slide lies on it",
        way_in_words(*axis, *asked)
    )]
    CheckStands {
        /// The active objective.
        objective: ObjectiveId,
        /// The axis.
        axis: Axis,
        /// How far it was sent, m or rad.
        asked: f64,
    },
    /// The tilt could not be seen, or the stage did not level it.
    #[error(transparent)]
    Level(#[from] crate::LevelError),
    /// Something failed, and the stage could not be taken back from the specimen to where the command began.
    #[error(
        "{error}. And the stage may stand nearer to the specimen than it did before, as it could not be taken back: {why}"
    )]
    StaysNear {
        /// What failed.
        error: Box<ServoError>,
        /// Why the stage stays.
        why: ScopeError,
    },
    /// What is needed to go on is not there, or there is nothing to go on with.
    #[error("{0}")]
    CannotGoOn(String),
}
