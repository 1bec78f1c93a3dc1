//! The `optimise` command.

fn main() -> std::process::ExitCode {
    powderline_optimiser::cli::main()
}
