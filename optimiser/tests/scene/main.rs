//! Scenes: reading, refusing, writing, packing.

mod shipped;
