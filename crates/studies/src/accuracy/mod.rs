//! The accuracy study: which pairs there are, how they are made, what we find in them, and how methods are compared.

pub mod comparison;
pub mod degrade;
pub mod ours;
pub mod rows;
pub mod scenes;
pub mod statistics;
pub mod table;
