use proptest::prelude::*;

use super::oracle::{Planes, Seen, image, in_camera, planes};
use super::*;
use crate::camera::Intrinsics;
use crate::threads;

const SIZE: Size = Size { height: 24, width: 32 };
const STILL: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn view(translation: [f64; 3]) -> View {
    let camera =
        Intrinsics { skew: 0.7, ..Intrinsics::new(30.0, 28.0, 16.0, 12.0).expect("valid") };
    View { rotation: STILL, translation, camera }
}

/// A camera of one pixel a metre at depth 1, the origin at the corner of the image.
fn plain() -> View {
    let camera = Intrinsics::new(1.0, 1.0, 0.0, 0.0).expect("valid");
    View { rotation: STILL, translation: [0.0; 3], camera }
}

fn draw_one(model: &Model, view: View, size: Size, near: Option<f64>) -> Planes<f64> {
    let surfaces = [Surface::new(model)];
    planes(&Scenes { surfaces: &surfaces, views: &[view], size, near }, Normals::Flat)
}

#[test]
fn one_small_image_is_for_the_caller() {
    let model = Model::new(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]);
    let model = model.expect("valid");
    let surfaces = [Surface::new(&model)];
    let threads = |images: usize, [height, width]: [usize; 2], asked| {
        let views = vec![plain(); images];
        let size = Size { height, width };
        Scenes { surfaces: &surfaces, views: &views, size, near: None }.threads(asked)
    };
    assert_eq!([threads(1, [512, 512], 0), threads(1, [513, 512], 0)], [1, 0]);
    assert_eq!([threads(2, [24, 32], 0), threads(1, [24, 32], 2)], [0, 2]);
}

fn soup() -> impl Strategy<Value = Model> {
    prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-1.0..1.0_f64)), 1..20)
        .prop_map(|triangles| {
            let faces: Vec<[u32; 3]> =
                (0..triangles.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
            Model::new(triangles.as_flattened(), &faces).expect("valid")
        })
}

fn compare(models: &[Model], views: &[View], near: f64) -> Result<(), TestCaseError> {
    let surfaces: Vec<_> = models.iter().map(Surface::new).collect();
    let scenes = Scenes { surfaces: &surfaces, views, size: SIZE, near: Some(near) };
    let drawn: Planes<f64> = planes(&scenes, Normals::Flat);
    let mut unclear = 0;
    for (k, seen) in image(models, views, SIZE, near).into_iter().enumerate() {
        match seen {
            Seen::Unclear => unclear += 1,
            Seen::Nothing => {
                prop_assert_eq!((drawn.object[k], drawn.face[k], drawn.mask[k]), (-1, -1, false));
                prop_assert_eq!(drawn.depth[k].to_bits(), 0);
                prop_assert!(drawn.normal[3 * k..3 * k + 3].iter().all(|&n| n == 0.0));
            }
            Seen::Point(f) => {
                let ids = (drawn.object[k] as usize, drawn.face[k] as usize, drawn.mask[k]);
                prop_assert_eq!(ids, (f.surface, f.face, true), "pixel {}", k);
                prop_assert!((drawn.depth[k] / f.depth - 1.0).abs() < 1e-9);
                let b = &drawn.barycentrics[3 * k..3 * k + 3];
                prop_assert!(b.iter().all(|&b| b >= 0.0));
                prop_assert!((b.iter().sum::<f64>() - 1.0).abs() < 1e-12);
                let face = models[f.surface].faces()[f.face];
                let p = face
                    .map(|v| in_camera(models[f.surface].vertex(v as usize), &views[f.surface]));
                let by = |w: &[f64], axis: usize| (0..3).map(|c| w[c] * p[c][axis]).sum::<f64>();
                prop_assert!((0..3).all(|k| (by(b, k) - by(&f.barycentrics, k)).abs() < 1e-7));
            }
        }
    }
    prop_assert!(unclear < SIZE.pixels() / 4);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn soups_are_seen_as_by_rays(a in soup(), b in soup(), z in 1.5..4.0_f64) {
        compare(&[a, b], &[view([0.1, -0.2, z]), view([-0.3, 0.2, z + 0.3])], 1e-3)?;
    }

    #[test]
    fn faces_across_the_near_plane_are_seen_as_by_rays(a in soup(), b in soup(), z in -0.5..0.8_f64) {
        compare(&[a, b], &[view([0.1, -0.2, z]), view([-0.3, 0.2, z + 0.3])], 0.2)?;
    }

    #[test]
    fn the_points_of_barycentrics_project_to_the_pixel_centres(a in soup(), z in -0.5..2.0_f64) {
        let view = view([0.1, 0.0, z]);
        let drawn = draw_one(&a, view, SIZE, Some(0.3));
        for k in (0..SIZE.pixels()).filter(|&k| drawn.mask[k]) {
            let face = a.faces()[drawn.face[k] as usize];
            let p = face.map(|v| in_camera(a.vertex(v as usize), &view));
            let b = &drawn.barycentrics[3 * k..3 * k + 3];
            let point = [0, 1, 2].map(|axis| (0..3).map(|c| b[c] * p[c][axis]).sum::<f64>());
            let at = oracle::project(point, &view.camera);
            let centre = [(k % SIZE.width) as f64 + 0.5, (k / SIZE.width) as f64 + 0.5];
            // Edge-on slivers have few digits left.
            prop_assert!((at[0] - centre[0]).hypot(at[1] - centre[1]) < 1e-5, "{:?} {:?}", at, centre);
            prop_assert!(point[2] > 0.3 * (1.0 - 1e-9));
        }
    }

}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    #[test]
    fn threads_change_no_bit(a in soup(), b in soup()) {
        // Several bands: more than 2^18 pixels.
        let size = Size { height: 130, width: 2100 };
        let camera = Intrinsics::new(900.0, 100.0, 1000.0, 65.0).expect("valid");
        let views = [[0.0, 0.0, 2.0], [0.2, 0.1, 2.2], [0.1, 0.1, 1.2], [-0.2, 0.0, 0.9]]
            .map(|t| View { camera, ..view(t) });
        let surfaces = [Surface::new(&a), Surface::new(&b)];
        let scenes = Scenes { surfaces: &surfaces, views: &views, size, near: Some(0.1) };
        prop_assert!(band::band_rows(size, 1) < size.height);
        let one: Planes<f32> = threads::install(1, || planes(&scenes, Normals::Flat)).expect("run");
        for count in [2, 7] {
            let more = threads::install(count, || planes(&scenes, Normals::Flat)).expect("run");
            prop_assert!(one == more);
        }
    }
}

#[test]
fn a_square_holds_its_border_and_each_centre_has_one_face() {
    // Corners and diagonal at pixel centres.
    let v = [[0.5, 0.5, 1.0], [4.5, 0.5, 1.0], [4.5, 4.5, 1.0], [0.5, 4.5, 1.0]];
    let size = Size { height: 6, width: 7 };
    for faces in [[[0, 1, 2], [0, 2, 3]], [[2, 1, 0], [0, 2, 3]], [[0, 2, 3], [1, 2, 0]]] {
        let model = Model::new(&v, &faces).expect("valid");
        let drawn = draw_one(&model, plain(), size, None);
        for (k, &face) in drawn.face.iter().enumerate() {
            let (i, j) = (k / 7, k % 7);
            assert_eq!(face >= 0, i < 5 && j < 5, "{i} {j}");
            if i < 5 && i == j {
                assert_eq!(face, 0, "the lower index where both hold the centre");
            }
        }
    }
}

#[test]
fn a_tilted_plane_has_the_depth_of_its_equation() {
    // z = 2 + 0.5 x - 0.25 y at 1/z affine in the image.
    let at = |x: f64, y: f64| [x, y, 2.0 + 0.5 * x - 0.25 * y];
    let v = [at(-2.0, -2.0), at(2.0, -2.0), at(2.0, 2.0), at(-2.0, 2.0)];
    let model = Model::new(&v, &[[0, 1, 2], [2, 3, 0]]).expect("valid");
    let camera = Intrinsics::new(20.0, 20.0, 10.0, 8.0).expect("valid");
    let size = Size { height: 16, width: 20 };
    let drawn = draw_one(&model, View { camera, ..plain() }, size, None);
    let mut seen = 0;
    for (k, &depth) in drawn.depth.iter().enumerate().filter(|d| *d.1 > 0.0) {
        let (x, y) = ((k % 20) as f64 + 0.5 - 10.0, (k / 20) as f64 + 0.5 - 8.0);
        let expected = 2.0 / (1.0 - 0.5 * x / 20.0 + 0.25 * y / 20.0);
        assert!((depth / expected - 1.0).abs() < 1e-13, "{depth} {expected}");
        seen += 1;
    }
    assert!(seen > 150, "{seen}");
}

#[test]
fn of_equal_surfaces_the_first_is_seen_whatever_the_winding() {
    let v = [[-0.61, -0.43, 0.1], [0.57, -0.31, 0.4], [0.13, 0.59, -0.2]];
    let turned = [v[2], v[1], v[0]];
    let first = Model::new(&v, &[[0, 1, 2], [2, 1, 0], [1, 2, 0]]).expect("valid");
    let other = Model::new(&turned, &[[0, 1, 2]]).expect("valid");
    for models in [[&first, &other], [&other, &first]] {
        let surfaces = models.map(Surface::new);
        let views = [view([0.0, 0.0, 1.7]); 2];
        let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
        let drawn: Planes<f32> = planes(&scenes, Normals::Flat);
        assert!(drawn.mask.iter().filter(|&&m| m).count() > 50);
        assert!(drawn.object.iter().all(|&o| o <= 0) && drawn.face.iter().all(|&f| f <= 0));
    }
}

#[test]
fn faces_without_area_and_behind_the_camera_hold_nothing() {
    let v = [
        [0.0, 0.0, 1.0],
        [4.0, 4.0, 1.0],
        [2.0, 2.0, 1.0],
        [0.0, 0.0, -1.0],
        [4.0, 0.0, -1.0],
        [0.0, 4.0, -2.0],
    ];
    let model = Model::new(&v, &[[0, 1, 2], [0, 0, 1], [2, 2, 2], [3, 4, 5]]).expect("valid");
    let drawn = draw_one(&model, plain(), SIZE, None);
    assert!(drawn.face.iter().all(|&f| f == -1) && drawn.depth.iter().all(|&d| d == 0.0));
}

/// A sphere of triangles, wound outwards, with each vertex three times.
fn sphere() -> Model {
    let at = |i: usize, j: usize| {
        let (a, b) = (
            std::f64::consts::PI * i as f64 / 24.0,
            std::f64::consts::TAU * (j % 48) as f64 / 48.0,
        );
        if i.is_multiple_of(24) {
            return [0.0, 0.0, a.cos().signum()];
        }
        [a.sin() * b.cos(), a.sin() * b.sin(), a.cos()]
    };
    let mut triangles = Vec::new();
    for i in 0..24 {
        for j in 0..48 {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let faces: Vec<[u32; 3]> =
        (0..triangles.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
    Model::new(triangles.as_flattened(), &faces).expect("valid")
}

#[test]
fn smooth_normals_of_a_sphere_point_outwards_and_flat_ones_nearly() {
    let model = sphere();
    for weight in [normals::Weight::Area, normals::Weight::Angle] {
        let of_vertices = normals::of_vertices(&model, weight);
        for (k, n) in of_vertices.iter().enumerate() {
            let p = model.vertex(k);
            let cosine: f64 = (0..3).map(|c| n[c] * p[c]).sum();
            assert!(cosine > 0.9997, "{cosine}");
        }
        let surfaces = [Surface { normals: Some(&of_vertices), ..Surface::new(&model) }];
        let turn = [[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]];
        let view = View { rotation: turn, ..view([0.2, 0.1, 4.0]) };
        let scenes = Scenes { surfaces: &surfaces, views: &[view], size: SIZE, near: None };
        for (kind, least) in [(Normals::Flat, 0.995), (Normals::Smooth, 0.9997)] {
            let drawn: Planes<f64> = planes(&scenes, kind);
            for k in (0..SIZE.pixels()).filter(|&k| drawn.mask[k]) {
                let (u, v) = ((k % 32) as f64 + 0.5 - 16.0, (k / 32) as f64 + 0.5 - 12.0);
                let z = drawn.depth[k];
                let y = v / 28.0 * z;
                let p = [(u * z - 0.7 * y) / 30.0 - 0.2, y - 0.1, z - 4.0];
                let n = &drawn.normal[3 * k..3 * k + 3];
                let radius = p.iter().map(|c| c * c).sum::<f64>().sqrt();
                let cosine: f64 = (0..3).map(|c| n[c] * p[c]).sum::<f64>() / radius;
                assert!(cosine > least, "{kind:?} {cosine}");
                assert!((n.iter().map(|c| c * c).sum::<f64>() - 1.0).abs() < 1e-12);
            }
        }
    }
}

#[test]
fn what_is_linear_is_interpolated_exactly() {
    let model = sphere();
    let n = model.vertex_count();
    let values: Vec<f64> = (0..n)
        .flat_map(|k| {
            let [x, y, z] = model.vertex(k);
            [0.3, 2.0 * x - y + 0.5 * z + 1.0]
        })
        .collect();
    let uv: Vec<[[f64; 2]; 3]> = model
        .faces()
        .iter()
        .map(|f| f.map(|k| model.vertex(k as usize)).map(|p| [p[0], p[1] - 3.0 * p[2]]))
        .collect();
    let first = Surface { attributes: Some(&values), uv: Some(&uv), ..Surface::new(&model) };
    let surfaces = [first, Surface::new(&model)];
    let views = [view([0.0, 0.0, 1.2]), view([0.9, 0.0, 3.0])];
    let scenes = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: Some(0.4) };
    let drawn: Planes<f64> = planes(&scenes, Normals::Flat);
    let mut of_object = [0; 2];
    for k in (0..SIZE.pixels()).filter(|&k| drawn.mask[k]) {
        of_object[drawn.object[k] as usize] += 1;
        let (got, uv) = (&drawn.attributes[2 * k..2 * k + 2], &drawn.uv[2 * k..2 * k + 2]);
        if drawn.object[k] == 1 {
            assert!(got == [0.0; 2] && uv == [0.0; 2], "a surface without values");
            continue;
        }
        let (u, v, z) = ((k % 32) as f64 - 15.5, (k / 32) as f64 - 11.5, drawn.depth[k]);
        let y = v / 28.0 * z;
        let p = [(u * z - 0.7 * y) / 30.0, y, z - 1.2];
        assert_eq!(got[0].to_bits(), 0.3_f64.to_bits(), "a constant stays what it is");
        assert!((got[1] - (2.0 * p[0] - p[1] + 0.5 * p[2] + 1.0)).abs() < 1e-9);
        assert!((uv[0] - p[0]).abs() < 1e-9 && (uv[1] - p[1] + 3.0 * p[2]).abs() < 1e-9);
    }
    assert!(of_object[0] > 100, "{of_object:?}");
}

#[test]
fn what_cannot_be_drawn_is_refused_by_name() {
    let model = sphere();
    let (surfaces, views) = ([Surface::new(&model)], [view([0.0, 0.0, 3.0])]);
    let good = Scenes { surfaces: &surfaces, views: &views, size: SIZE, near: None };
    let message = |scenes: Scenes<'_>| scenes.check().expect_err("refused").to_string();
    assert!(message(Scenes { surfaces: &[], ..good }).starts_with("mesh:"));
    let two = [surfaces[0]; 2];
    assert!(message(Scenes { surfaces: &two, ..good }).starts_with("R: 1 poses for 2"));
    assert!(message(Scenes { near: Some(0.0), ..good }).starts_with("near:"));
    assert!(message(Scenes { size: Size { height: 0, width: 3 }, ..good }).starts_with("height:"));
    assert!(
        message(Scenes { size: Size { height: 3, width: 20_000 }, ..good }).starts_with("width:")
    );
    let bad = [View { translation: [0.0, f64::NAN, 1.0], ..views[0] }];
    assert!(message(Scenes { views: &bad, ..good }).starts_with("t[0]:"));
    let values = [0.0; 7];
    let odd = [Surface { attributes: Some(&values), ..surfaces[0] }];
    assert!(message(Scenes { surfaces: &odd, ..good }).starts_with("attributes[0]: 7 numbers"));
    let mut depth = vec![0.0_f32; SIZE.pixels() * 3];
    let out = GBuffer { normal: Some(&mut depth), ..GBuffer::default() };
    let error = good.draw(Normals::Smooth, out).expect_err("no normals").to_string();
    assert!(error.starts_with("normals:"), "{error}");
    // No images: nothing to draw, and no error.
    Scenes { views: &[], ..good }.draw::<f32>(Normals::Flat, GBuffer::default()).expect("nothing");
}

#[test]
fn planes_past_the_caches_are_cleared_all_over() {
    let (width, height, channels) = (2000, 30, 3);
    for dirty in [
        Dirty { rows: 7..12, columns: 30..400 },
        Dirty { rows: 0..30, columns: 0..2000 },
        Dirty { rows: 0..0, columns: 0..0 },
    ] {
        let blank = Blank { background: Background::Far, width, dirty: &dirty };
        let mut plane = vec![f32::NAN; width * height * channels];
        blank.fill(&mut plane, channels, 0.0);
        assert!(plane.iter().all(|&value| value == 0.0), "{dirty:?}");
        let mut ids = vec![3; width * height];
        blank.fill(&mut ids, 1, -1);
        assert!(ids.iter().all(|&id| id == -1), "{dirty:?}");
    }
}
