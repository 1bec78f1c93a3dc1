//! The program `firmware-sim`: the simulated arm at the end of a wire ([`serve`]), and executor and arm together on a
//! simulated wire with every fault we can think of ([`link`], [`storm`]).

pub mod link;
pub mod serve;
pub mod storm;
