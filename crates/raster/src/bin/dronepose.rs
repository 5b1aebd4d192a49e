//! The command `dronepose`.

fn main() -> std::process::ExitCode {
    dronepose_raster::cli::command::main()
}
