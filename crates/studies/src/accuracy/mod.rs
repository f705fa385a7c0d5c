//! The accuracy study: which pairs there are, how they are made, and how methods are compared on them.

pub mod degrade;
pub mod scenes;
