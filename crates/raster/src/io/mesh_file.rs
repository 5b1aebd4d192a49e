//! Reading a mesh in whichever of the three formats it is, and what the readers share.

use std::path::Path;

use super::mesh_text::not_a;
use super::{obj, ply, stl};
use crate::error::Result;
use crate::io::input::{Input, InputFile};
use crate::mesh::Mesh;

/// A mesh above this is refused: what comes from `/dev/zero` has no end.
const LARGEST_FILE: u64 = 1 << 30;

/// Reads a mesh: Wavefront OBJ, PLY or STL, by the file's extension and, where that is none of
/// these, by how the content begins.
///
/// Coordinates are those of the file, in its unit; see [`Mesh::scaled`].
///
/// # Errors
/// [`crate::Error::Read`], [`crate::Error::Malformed`] with the line, vertex or face, and what was expected.
pub fn read_mesh(path: &Path) -> Result<Mesh> {
    read_mesh_file(path).map(|(mesh, _)| mesh)
}

/// As [`read_mesh`], with the record of the file. It is read once, so it may be a pipe; gzip is
/// unpacked.
///
/// # Errors
/// As [`read_mesh`].
pub fn read_mesh_file(path: &Path) -> Result<(Mesh, InputFile)> {
    let mut input = Input::open(path)?;
    let bytes = input.read_all(LARGEST_FILE)?;
    let name = path.display().to_string();
    let unpacked = match path.extension() {
        Some(gz) if gz.eq_ignore_ascii_case("gz") => path.file_stem().map(Path::new),
        _ => Some(path),
    };
    let extension =
        unpacked.and_then(Path::extension).map(|e| e.to_string_lossy().to_ascii_lowercase());
    let (mesh, format) = match extension.as_deref() {
        Some("obj") => (obj::parse_obj(&bytes, &name), "obj"),
        Some("ply") => (ply::parse_ply(&bytes, &name), "ply"),
        Some("stl") => (stl::parse_stl(&bytes, &name), "stl"),
        _ if ply::looks_like(&bytes) => (ply::parse_ply(&bytes, &name), "ply"),
        _ if stl::looks_like(&bytes) => (stl::parse_stl(&bytes, &name), "stl"),
        _ if obj::looks_like(&bytes) => (obj::parse_obj(&bytes, &name), "obj"),
        _ => return Err(not_a(&bytes, &name, "a mesh in the format OBJ, PLY or STL")),
    };
    Ok((mesh?, input.finish(format)?))
}

#[cfg(test)]
pub(crate) mod shared {
    //! The data shared beside the repository: real drones, not part of it.

    use std::path::{Path, PathBuf};

    /// A file of the shared data: below `DRONEPOSE_SHARED`, or `../shared` from the repository.
    pub(crate) fn file(relative: &str) -> Option<PathBuf> {
        let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
        let root = std::env::var_os("DRONEPOSE_SHARED").map_or_else(beside, PathBuf::from);
        let path = root.join(relative);
        if path.exists() {
            return Some(path);
        }
        #[expect(clippy::print_stdout, reason = "a skipped test says why")]
        {
            println!("skipped: {} is not there (set DRONEPOSE_SHARED)", path.display());
        }
        None
    }
}

#[cfg(test)]
#[expect(clippy::float_cmp, reason = "that results are exact is what is tested")]
mod tests {
    use std::fs;
    use std::time::Instant;

    use glam::DVec3;

    use super::*;
    use crate::io::mesh_text::triangulate;

    fn refusal(path: &Path) -> String {
        read_mesh(path).unwrap_err().to_string()
    }

    #[test]
    fn what_is_no_mesh_is_refused_by_name() {
        let folder = tempfile::tempdir().expect("a folder");
        assert!(refusal(folder.path()).starts_with("cannot read "));
        assert!(refusal(&folder.path().join("missing.obj")).contains("missing.obj: "));
        let cases: [(&str, &[u8], &str); 9] = [
            ("a.obj", b"", "a.obj: found an empty file, expected"),
            ("b.ply", b"", "b.ply: found an empty file, expected"),
            ("c.stl", b"", "c.stl: found an empty file, expected"),
            ("d", b"", "d: found an empty file, expected"),
            (
                "e.obj",
                b"<!DOCTYPE html>\n<p>v",
                "e.obj: found a web page or XML, beginning with '<!DOCTYPE",
            ),
            ("f.stl", b"<html>", "f.stl: found a web page"),
            ("g.ply", b"<html>", "g.ply: found a web page"),
            ("h.dae", b"<?xml version", "expected a mesh in the format OBJ, PLY or STL"),
            ("i.obj", b"PK\x03\x04\0\0", "i.obj: found binary data, expected"),
        ];
        for (name, bytes, wanted) in cases {
            let path = folder.path().join(name);
            fs::write(&path, bytes).expect("written");
            let text = refusal(&path);
            assert!(text.contains(wanted) && !text.contains('\n'), "{name}: {text}");
        }
    }

    #[test]
    fn a_file_without_a_known_extension_is_known_by_its_content() {
        let folder = tempfile::tempdir().expect("a folder");
        let cases: [(&str, &[u8]); 3] = [
            ("a.txt", b"# box\nv 0 0 0\nv 1 0 0\n"),
            ("b", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n"),
            ("c.bin", b"solid x\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"),
        ];
        for (name, bytes) in cases {
            let path = folder.path().join(name);
            fs::write(&path, bytes).expect("written");
            assert!(read_mesh(&path).is_ok(), "{name}");
        }
        let path = folder.path().join("UPPER.OBJ");
        fs::write(&path, b"v 0 0 0").expect("written");
        assert!(read_mesh(&path).is_ok());
    }

    #[test]
    fn a_packed_mesh_is_read() {
        use std::io::Write as _;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.obj.gz");
        let file = fs::File::create(&path).expect("created");
        let mut gz = flate2::write::GzEncoder::new(file, flate2::Compression::fast());
        gz.write_all(b"v 0 0 0\nv 1 0 0\n").expect("written");
        let size = gz.finish().expect("written").metadata().expect("there").len();
        let (mesh, file) = read_mesh_file(&path).expect("valid");
        assert_eq!((mesh.vertices().len(), file.bytes, file.format.as_str()), (2, size, "obj"));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_pipe_is_read_once() {
        use std::io::Write as _;
        let (reader, mut writer) = std::io::pipe().expect("a pipe");
        writer.write_all(b"v 0 0 0\nv 1 0 0\n").expect("written");
        drop(writer);
        let fd = std::os::fd::AsRawFd::as_raw_fd(&reader);
        let (mesh, file) = read_mesh_file(Path::new(&format!("/dev/fd/{fd}"))).expect("valid");
        assert_eq!((mesh.vertices().len(), file.bytes), (2, 16));
    }

    #[test]
    fn a_concave_polygon_is_not_covered_twice() {
        // An arrow head, an L, and their reverses; the area of the triangles is that of the polygon.
        let shapes: [(&[[f64; 2]], f64); 3] = [
            (&[[0.0, 0.0], [2.0, 1.0], [0.0, 2.0], [1.0, 1.0]], 1.0),
            (&[[0.0, 0.0], [3.0, 0.0], [3.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]], 5.0),
            (&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], 1.0),
        ];
        for (shape, area) in shapes {
            let vertices: Vec<_> = shape.iter().map(|p| DVec3::new(p[0], p[1], 5.0)).collect();
            let mut corners: Vec<u32> = (0..shape.len() as u32).collect();
            for _ in 0..2 {
                for _ in 0..shape.len() {
                    corners.rotate_left(1);
                    let mut faces = Vec::new();
                    triangulate(&vertices, &corners, &mut faces);
                    assert_eq!(faces.len(), shape.len() - 2);
                    let half = |f: &[u32; 3]| {
                        let [a, b, c] = f.map(|k| vertices[k as usize]);
                        0.5 * (b - a).cross(c - a).length()
                    };
                    let sum: f64 = faces.iter().map(half).sum();
                    assert!((sum - area).abs() < 1e-12, "{corners:?}: {faces:?}");
                }
                corners.reverse();
            }
        }
    }

    /// Name, vertices, faces, and of the welded mesh: boundary edges, edges of more than two
    /// faces, components.
    const DRONES: [(&str, [usize; 5]); 8] = [
        ("crazyflie2/cf2_assembly.stl", [9966, 3322, 32, 137, 33]),
        ("dji_mavic2/DJI.obj", [3010, 5013, 203, 0, 20]),
        ("firefly/firefly.ply", [50769, 85154, 18708, 78, 152]),
        ("hector/quadrotor_base.stl", [1620, 540, 0, 0, 15]),
        ("holybro_x500/hb_x500_fused.stl", [370_224, 123_408, 346, 3333, 19]),
        ("iris/iris.stl", [239_988, 79_996, 0, 58_152, 13]),
        ("omnicopter/omnicopter.stl", [80_394, 26_798, 0, 39, 51]),
        ("skydio_x2/assets/X2_lowpoly.obj", [4303, 2554, 198, 61, 38]),
    ];

    #[test]
    #[expect(clippy::print_stdout, reason = "timings, shown with --nocapture")]
    fn every_drone_is_read_and_has_its_counts_and_its_exact_diameter() {
        for (name, counts) in DRONES {
            let Some(path) = shared::file(&format!("data/drones/{name}")) else { return };
            let start = Instant::now();
            let mesh = read_mesh(&path).expect(name);
            let read = start.elapsed();
            let unique = &mesh.unique_vertices().positions;
            let start = Instant::now();
            let candidates = mesh.hull_candidates().len();
            let hull = start.elapsed();
            let start = Instant::now();
            let diameter = mesh.diameter();
            let rest = start.elapsed();
            let distinct = unique.len();
            println!(
                "{name}: read {read:.1?}, {distinct} distinct, {candidates} candidates {hull:.1?}, diameter {rest:.1?}"
            );
            let check = mesh.check();
            let found = [
                check.vertices,
                check.faces,
                check.boundary_edges,
                check.crowded_edges,
                check.components,
            ];
            assert_eq!(found, counts, "{name}");
            // Brute force takes a minute for the heavy ones.
            if distinct < 20_000 {
                let mut best = 0.0_f64;
                for (k, p) in unique.iter().enumerate() {
                    best = unique[k..].iter().map(|q| p.distance_squared(*q)).fold(best, f64::max);
                }
                assert_eq!(diameter, best.sqrt(), "{name}");
            }
        }
    }

    #[test]
    fn the_lengths_of_the_paper_s_drone_and_of_a_point_set_are_known() {
        let Some(path) = shared::file("data/drones/dji_mavic2/DJI.obj") else { return };
        let mesh = read_mesh(&path).expect("valid");
        assert!((mesh.bbox_diagonal() - 0.608_931_015_743_162_8).abs() < 1e-12);
        assert!((mesh.diameter() - 0.537_637_922_023_735_3).abs() < 1e-12);
        let Some(path) = shared::file("cases/eval/models/box.obj") else { return };
        let mesh = read_mesh(&path).expect("valid");
        assert!((mesh.bbox_diagonal() - 0.509_901_951_359_278_5).abs() < 1e-12);
        assert!((mesh.diameter() - 0.509_901_951_359_278_5).abs() < 1e-12);
        assert!(mesh.faces().is_empty());
    }
}
