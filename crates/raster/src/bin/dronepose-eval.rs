//! The command `dronepose-eval`.

fn main() -> std::process::ExitCode {
    dronepose_raster::cli::main()
}
