//! Scenes: reading, refusing, writing, packing.

mod files;
mod geometry;
mod packing;
mod refusals;
mod shipped;
mod writing;
