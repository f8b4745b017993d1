//! The operator's command. Its code is in [`layerd::cli`].

fn main() -> std::process::ExitCode {
    layerd::cli::run()
}
