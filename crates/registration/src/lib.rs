//! Two images to target_from_view, its covariance and a verdict.
