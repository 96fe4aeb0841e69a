//! Areas and volumes of many surfaces at a small cost, beside their exact measures.

use std::f64::consts::{PI, TAU};

use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis, Tangents};
use shapelex_geometry::surface::measures::SurfaceMeasures;
use shapelex_geometry::surface::measures::sizes::{AREA_TOLERANCE, SheetSizes, VOLUME_TOLERANCE};
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

use crate::spaces::Noise;

/// A point of the usual surface of a topology.
fn usual(topology: Topology, u: f64, v: f64) -> [f64; 3] {
    let (s, c) = (TAU * u).sin_cos();
    match topology {
        Topology::Sphere | Topology::SharpSphere => {
            let (across, along) = (PI * v).sin_cos();
            [c * across, s * across, along]
        }
        Topology::Cylinder => [c, s, 2.0 * v],
        Topology::Torus => {
            let (across, along) = (TAU * v).sin_cos();
            [c * (2.0 + 0.7 * along), s * (2.0 + 0.7 * along), 0.7 * across]
        }
        Topology::Plane => [u, 2.0 * v, 0.2 * (s + v * v)],
    }
}

/// Control points of the usual surface, with noise.
fn rows(basis: &SurfaceBasis, noise: f64) -> Matrix {
    let Extent { topology, intervals } = basis.extent();
    let [count_u, count_v] = basis.extent().grid();
    let points = Matrix::from_fn(count_u * count_v, 3, |i, c| {
        let (k, l) = (i / count_v, i % count_v);
        usual(topology, k as f64 / intervals[0] as f64, l as f64 / intervals[1] as f64)[c]
    });
    let round = basis.interpolate(&points, &Tangents::default());
    let random = Noise(7).matrix(round.nrows(), 3);
    round + random * noise
}

/// Largest relative error of an area, of surfaces so rough that their normals vanish between nodes.
const WORST_AREA: f64 = 1e-4;

#[test]
fn sizes_of_sheets_are_those_of_their_measures() {
    let (mut compared, mut rough) = (0, 0);
    for topology in Topology::ALL {
        for kind in GeneratorKind::catalogue() {
            for intervals in [[3, 4], [5, 4], [8, 9], [16, 16]] {
                let kinds = [kind.clone(), kind.clone()];
                let extent = Extent { topology, intervals };
                let Ok(basis) = SurfaceBasis::new(extent, Seam::Straight, &kinds) else { continue };
                for noise in [0.0, 0.02, 0.1] {
                    let rows = rows(&basis, noise);
                    let (measures, sizes) = (SurfaceMeasures::of(&basis.surface(&rows)), basis.sizes(&rows));
                    let what = format!("{topology:?}, {kind:?}, {intervals:?}, noise {noise}");
                    let error = (sizes.area / measures.area - 1.0).abs();
                    assert!(error <= WORST_AREA, "{what}: area by {error:e}");
                    rough += usize::from(error > AREA_TOLERANCE);
                    let exact = measures.enclosed.map(|enclosed| enclosed.signed_volume);
                    assert_eq!(exact.is_some(), sizes.signed_volume.is_some(), "{what}");
                    if let (Some(exact), Some(found)) = (exact, sizes.signed_volume) {
                        let error = (found - exact).abs() / measures.area.powf(1.5);
                        assert!(error <= VOLUME_TOLERANCE, "{what}: volume by {error:e}");
                    }
                    compared += 1;
                }
            }
        }
    }
    assert!(compared > 300 && rough * 20 < compared, "{rough} of {compared} areas are beyond the tolerance");
}

#[test]
fn sizes_of_sheets_do_not_depend_on_the_unit_or_the_place() {
    let extent = Extent { topology: Topology::Torus, intervals: [5, 4] };
    let basis = SurfaceBasis::new(
        extent,
        Seam::Straight,
        &[GeneratorKind::Trigonometric {}, GeneratorKind::Cubic {}],
    )
    .unwrap();
    let rows = rows(&basis, 0.02);
    let here = basis.sizes(&rows);
    for unit in [-200, -30, 40, 250].map(|exponent| 2.0_f64.powi(exponent)) {
        let there = basis.sizes(&(&rows * unit));
        assert_eq!(there.area, here.area * unit * unit);
        assert_eq!(there.signed_volume, here.signed_volume.map(|volume| volume * unit * unit * unit));
    }
    let moved = basis.sizes(&rows.add_scalar(1e6));
    assert!((moved.area / here.area - 1.0).abs() < 1e-8, "{moved:?}");
    let volumes = [moved, here].map(|sizes| sizes.signed_volume.unwrap());
    assert!((volumes[0] / volumes[1] - 1.0).abs() < 1e-8, "{volumes:?}");
    let nothing = basis.sizes(&(&rows * 0.0));
    assert_eq!(nothing, SheetSizes { area: 0.0, signed_volume: Some(0.0) });
}
