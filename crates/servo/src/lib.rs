//! Focus, calibrate, control, reposition: Algorithm 1 as a page to read first.
