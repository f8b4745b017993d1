//! The operator's command; everything is in [`layerd::cli`].

fn main() -> std::process::ExitCode {
    layerd::cli::run()
}
