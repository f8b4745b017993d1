//! The operator's command; its code is in [`layerd::cli`]. `layerctl demo` shows everything on a simulated machine.

fn main() -> std::process::ExitCode {
    layerd::cli::run()
}
