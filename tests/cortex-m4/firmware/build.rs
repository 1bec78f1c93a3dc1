//! The memory map for the linker, and the plan for the flash: that of `PLAN`, or the golden one.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let here = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").ok_or(io::ErrorKind::NotFound)?);
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or(io::ErrorKind::NotFound)?);
    let plan = env::var_os("PLAN")
        .map_or_else(|| here.join("../../../shared/tests/golden/plan-v4.plan"), PathBuf::from);
    fs::copy(here.join("memory.x"), out.join("memory.x"))?;
    fs::copy(&plan, out.join("plan"))?;
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    println!("cargo::rerun-if-env-changed=PLAN");
    for input in [Path::new("memory.x"), &plan] {
        println!("cargo::rerun-if-changed={}", input.display());
    }
    Ok(())
}
