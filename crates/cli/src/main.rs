//! The program `scopeservo`.
fn main() {}
