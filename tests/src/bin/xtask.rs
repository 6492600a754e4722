//! `cargo xtask …`: see [`plumbline_tests::xtask`].

fn main() -> std::process::ExitCode {
    plumbline_tests::xtask::main()
}
