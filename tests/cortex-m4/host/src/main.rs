//! The host's side.
//!
//! | command              | does                                                                               |
//! |----------------------|------------------------------------------------------------------------------------|
//! | `plan FILE`          | writes a plan as long and as lively as one that the optimiser makes                |
//! | `expect PLAN`        | prints what the firmware's report must contain, computed here                      |
//! | `arm SOCKET PLAN`    | plays the arm at the serial line until the other end closes it; fails unless it then stands at the plan's end |
#![forbid(unsafe_code)]

mod arm;
mod plan;

use std::env;
use std::fs;

use anyhow::{Context as _, Result, bail};
use powderline_cortex_m4_common::pose_bits;
use powderline_shared::plan::PlanReader;

fn main() -> Result<()> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match arguments[..] {
        ["plan", file] => fs::write(file, plan::bytes()?).with_context(|| format!("cannot write {file}")),
        ["expect", file] => expect(file),
        ["arm", socket, file] => arm::play(socket, &with_plan(&read(file)?)?),
        _ => bail!("usage: plan FILE | expect PLAN | arm SOCKET PLAN"),
    }
}

fn read(file: &str) -> Result<Vec<u8>> {
    fs::read(file).with_context(|| format!("cannot read {file}"))
}

fn with_plan(bytes: &[u8]) -> Result<PlanReader<'_>> {
    PlanReader::new(bytes).context("that is no plan")
}

fn expect(file: &str) -> Result<()> {
    let bytes = read(file)?;
    let plan = with_plan(&bytes)?;
    let poses = pose_bits(&plan);
    let [x, y, z, qw, qx, qy, qz] = poses.end;
    let peak_jerk = plan.check_limits()?.linear_jerk.to_bits();
    println!(
        "poses={:016x} x={x:016x} y={y:016x} z={z:016x} qw={qw:016x} qx={qx:016x} qy={qy:016x} qz={qz:016x} \
         peak_jerk={peak_jerk:016x}",
        poses.all
    );
    Ok(())
}
