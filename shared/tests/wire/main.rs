//! The wire from outside: pinned bytes, damage, loss, foreign sessions, hostile input, and the document that has it all.

mod cyclic;
mod damage;
mod document;
mod golden;
mod keyed;
mod line;
mod records;
mod round_trip;
mod samples;
