//! The words that both ends of a Powderline arm speak.
//!
//! The optimiser writes a [`plan`], the executor plays it, the arm's controller performs it. What the three must agree
//! on, to the last bit, lives here and only here: rotations ([`pose`]), quantised cumulative setpoints
//! ([`displacement`]), motion limits ([`limits`], and at less cost [`sieve`]), how far an arm may be off ([`following`]), fault codes ([`fault`]), the plan file ([`plan`]), what executor and arm
//! say to each other ([`wire`]), the motion that the arm has made ([`trajectory`]), which joints put its tool at a pose ([`arm`]),
//! and how powder is accounted for ([`census`], [`mass`]).
//!
//! No `std` (but for the feature of that name, with which programs read plan files), no allocation, no unsafe code: the same crate runs on the host and on a microcontroller, and `libm` gives both
//! the same bits. Nothing here is meant to panic; the lints below keep out what can be seen to, which is no proof.
#![no_std]
#![forbid(unsafe_code)]
#![warn(
    clippy::indexing_slicing,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::arithmetic_side_effects,
    clippy::cast_possible_truncation,
    clippy::std_instead_of_core
)]
#![cfg_attr(test, expect(clippy::unwrap_used, reason = "a test may stop at the first surprise"))]

#[cfg(any(test, feature = "std"))]
extern crate std;

pub mod arm;
pub mod census;
pub mod displacement;
pub mod fault;
pub mod following;
pub mod limits;
pub mod mass;
pub mod plan;
pub mod pose;
pub mod sieve;
pub mod trajectory;
pub mod wire;
