//! Plane transforms, closed forms, robust fits and their covariance.
