//! Shapes of several resolutions: the same functions on the finest grid, edits that stay in their region, refusals with their numbers.

use std::f64::consts::TAU;

use proptest::prelude::*;
use shapelex_geometry::GeometryError;
use shapelex_geometry::deformation::{ControlPointMove, Edit, Handle};
use shapelex_geometry::generator::{GeneratorKind, PoleList};
use shapelex_geometry::influence::weights;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::resolution::{Block, Detailed, Finer, ParameterRegion, Resolutions};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

use crate::refinement::{half_integer_shifts, is_exact, refinable, surfaces};
use crate::spaces::{Noise, closed, open};
use crate::vectors::assert_close;

/// Control points are random in ±1, offsets too; values are sums of at most some dozens of them.
const SAME: f64 = 3e-12;

/// The value at a place of the shape with these control points.
fn value(space: &ShapeSpace, control_points: &Matrix, parameters: &[f64]) -> Vec<f64> {
    let parts = weights(space, parameters);
    let of = |c: usize| parts.iter().map(|(row, weight)| weight * control_points[(*row, c)]).sum();
    (0..control_points.ncols()).map(of).collect()
}

/// A block of all control points of a grid, with random offsets.
fn whole_block(coarse: &ShapeSpace, factors: &[usize], noise: &mut Noise) -> Block {
    let size = Finer::new(coarse, factors).unwrap().size();
    let offsets = noise.matrix(size, coarse.representation().dimension());
    Block { factors: factors.to_vec(), indices: (0..size).collect(), offsets }
}

/// The flat shape is the sum of the coarse one and of its details at every place; so are the shapes with blocks of no offsets.
fn assert_flat(
    coarse: &ShapeSpace,
    blocks: [Vec<usize>; 2],
    finest: &[usize],
    seed: u64,
    places: &[Vec<f64>],
) {
    let what = format!("{:?} with {blocks:?} by {finest:?}", coarse.representation());
    let mut noise = Noise(seed);
    let representation = coarse.representation();
    let control_points = noise.matrix(representation.size(), representation.dimension());
    let blocks: Vec<Block> = blocks.iter().map(|factors| whole_block(coarse, factors, &mut noise)).collect();
    let grids = Resolutions::new(coarse, blocks.iter().map(|block| &*block.factors), finest).unwrap();
    let still = blocks.iter().map(|block| Block { offsets: 0.0 * &block.offsets, ..block.clone() }).collect();
    let still = grids.flatten(&Detailed { control_points: control_points.clone(), blocks: still });
    let flat = grids.flatten(&Detailed { control_points: control_points.clone(), blocks: blocks.clone() });
    let space = grids.finest().space();
    assert_eq!(flat.nrows(), space.representation().size(), "{what}");
    for place in places {
        let ahead = grids.finest().parameters(place);
        let before = value(coarse, &control_points, place);
        assert_close(&format!("{what}: still at {place:?}"), &value(space, &still, &ahead), &before, SAME);
        let details = grids.detail_at(&blocks, place);
        let wanted: Vec<f64> = before.iter().zip(details).map(|(value, detail)| value + detail).collect();
        assert_close(&format!("{what} at {place:?}"), &value(space, &flat, &ahead), &wanted, SAME);
    }
}

/// Half-integer shifts that contain all ellipses: three poles.
fn around() -> GeneratorKind {
    half_integer_shifts(PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]))
}

/// The smallest number that both divide.
fn common(a: usize, b: usize) -> usize {
    (1..=b).map(|i| i * a).find(|multiple| multiple % b == 0).unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Curves with blocks of two grids, one of which need not refine the other.
    #[test]
    fn curves_of_several_resolutions_are_curves_of_the_finest(
        kind in prop::sample::select(refinable()),
        factors in prop::array::uniform2(prop::sample::select(vec![2_usize, 3, 4, 6])),
        more in prop::sample::select(vec![1_usize, 2, 3]),
        size in 6_usize..12,
        seed in any::<u64>(),
        places in prop::collection::vec(0.0..1.0, 20),
    ) {
        prop_assume!(factors.iter().all(|factor| is_exact(&kind, *factor)));
        let finest = [more * common(factors[0], factors[1])];
        let places: Vec<Vec<f64>> = places.into_iter().map(|u| vec![u]).collect();
        let blocks = factors.map(|factor| vec![factor]);
        assert_flat(&closed(&kind, size, 2).unwrap(), blocks.clone(), &finest, seed, &places);
        assert_flat(&open(&kind, size, 3).unwrap(), blocks, &finest, seed, &places);
    }

    /// Surfaces, with other factors along `u` and `v`.
    #[test]
    fn surfaces_of_several_resolutions_are_surfaces_of_the_finest(
        kinds in prop::array::uniform2(prop::sample::select(refinable())),
        factors in prop::array::uniform4(prop::sample::select(vec![1_usize, 2, 3, 4])),
        topology in prop::sample::select(vec![Topology::Torus, Topology::Cylinder, Topology::Plane]),
        seed in any::<u64>(),
        places in prop::collection::vec(prop::array::uniform2(0.0..1.0), 10),
    ) {
        let [a, b, c, d] = factors;
        let exact = |kind: &GeneratorKind, factor: usize| factor == 1 || is_exact(kind, factor);
        prop_assume!(exact(&kinds[0], a) && exact(&kinds[0], c) && exact(&kinds[1], b) && exact(&kinds[1], d));
        let space = surfaces(topology, Seam::Straight, [7, 6], kinds).unwrap();
        let places: Vec<Vec<f64>> = places.into_iter().map(Vec::from).collect();
        assert_flat(&space, [vec![a, b], vec![c, d]], &[common(a, c), common(b, d)], seed, &places);
    }

    /// Spheres, poles and tangents included, with an odd number of poles from pole to pole and around.
    #[test]
    fn spheres_of_several_resolutions_are_spheres_of_the_finest(
        along in prop::sample::select(vec![0_usize, 1, 2]),
        topology in prop::sample::select(vec![Topology::Sphere, Topology::SharpSphere]),
        factors in prop::array::uniform4(prop::sample::select(vec![2_usize, 4])),
        odd in prop::sample::select(vec![1_usize, 3]),
        seed in any::<u64>(),
        places in prop::collection::vec(prop::array::uniform2(0.0..1.0), 10),
    ) {
        let zeros = half_integer_shifts(PoleList::from_domain(&[[0.0, 0.0]; 3]));
        let along = [GeneratorKind::Bspline { degree: 2 }, GeneratorKind::Bspline { degree: 3 }, zeros][along].clone();
        let space = surfaces(topology, Seam::Straight, [7, 6], [around(), along]).unwrap();
        let [a, b, c, d] = factors;
        let places: Vec<Vec<f64>> = places.into_iter().map(Vec::from).collect();
        assert_flat(&space, [vec![a, b], vec![odd * c, d]], &[common(a, odd * c), common(b, d)], seed, &places);
    }
}

/// A shape of random control points with a block of a region, whose offsets are random too.
fn edited(coarse: &ShapeSpace, factors: &[usize], region: ParameterRegion, seed: u64) -> Detailed {
    let mut noise = Noise(seed);
    let representation = coarse.representation();
    let control_points = noise.matrix(representation.size(), representation.dimension());
    let indices = region.control_points(&Finer::new(coarse, factors).unwrap()).unwrap();
    let offsets = noise.matrix(indices.len(), representation.dimension());
    Detailed { control_points, blocks: vec![Block { factors: factors.to_vec(), indices, offsets }] }
}

/// Whether a parameter lies in an interval, which may go over the end of a closed direction.
fn lies_in(parameter: f64, interval: Option<[f64; 2]>) -> bool {
    interval
        .is_none_or(|[from, to]| (from..=to).contains(&parameter) || (from..=to).contains(&(parameter + 1.0)))
}

/// Blocks change the shape within their region, and not one bit of it elsewhere. Returns the number of places that changed.
fn assert_local(coarse: &ShapeSpace, factors: &[usize], region: ParameterRegion, seed: u64) -> usize {
    let shape = edited(coarse, factors, region, seed);
    let grids = Resolutions::new(coarse, [factors], factors).unwrap();
    let plain = Detailed { blocks: Vec::new(), ..shape.clone() };
    let (before, after) = (grids.flatten(&plain), grids.flatten(&shape));
    let space = grids.finest().space();
    let mut changed = 0;
    for i in 0..40 {
        for j in 0..if factors.len() == 2 { 40 } else { 1 } {
            let place = &[(i as f64 + 0.3) / 40.0, (j as f64 + 0.6) / 40.0][..factors.len()];
            let ahead = grids.finest().parameters(place);
            let same = value(space, &before, &ahead) == value(space, &after, &ahead);
            let inside = lies_in(place[0], region.u) && place.get(1).is_none_or(|v| lies_in(*v, region.v));
            assert!(
                same || inside,
                "{:?} changed at {place:?}, outside of {region:?}",
                coarse.representation()
            );
            changed += usize::from(!same);
        }
    }
    changed
}

#[test]
fn blocks_change_a_shape_in_their_region_only() {
    let region = |u: [f64; 2], v: Option<[f64; 2]>| ParameterRegion { u: Some(u), v };
    let quadratic = GeneratorKind::Bspline { degree: 2 };
    for kind in [around(), quadratic.clone(), GeneratorKind::Bspline { degree: 3 }] {
        for factor in [2, 4, 8] {
            let across =
                assert_local(&closed(&kind, 10, 2).unwrap(), &[factor], region([0.75, 1.25], None), 5);
            let middle = assert_local(&open(&kind, 10, 3).unwrap(), &[factor], region([0.2, 0.7], None), 6);
            // Nearly half of 40 places each; the functions of the last knots in the region reach into both ends of it.
            assert!(
                (12..=21).contains(&across) && (12..=21).contains(&middle),
                "{kind:?}: {across}, {middle}"
            );
        }
    }
    for topology in [Topology::Sphere, Topology::SharpSphere, Topology::Cylinder, Topology::Torus] {
        let space = surfaces(topology, Seam::Straight, [8, 6], [around(), quadratic.clone()]).unwrap();
        let changed = assert_local(&space, &[4, 2], region([0.25, 0.75], Some([0.2, 0.8])), 7);
        assert!((200..=500).contains(&changed), "{topology:?}: {changed} of 1600 places");
        // A cap with its pole, its handles and all meridians.
        let cap = ParameterRegion { u: None, v: Some([0.0, 0.5]) };
        let changed = assert_local(&space, &[2, 4], cap, 8);
        assert!((400..=800).contains(&changed), "{topology:?}: {changed} of 1600 places");
    }
}

/// The whole domain is a region of all control points; a region that holds none says how long one has to be.
#[test]
fn regions_hold_the_control_points_whose_supports_they_contain() {
    let space = closed(&GeneratorKind::Bspline { degree: 3 }, 8, 2).unwrap();
    let finer = Finer::new(&space, &[4]).unwrap();
    let of = |u: [f64; 2]| ParameterRegion { u: Some(u), v: None }.control_points(&finer);
    assert_eq!(of([0.0, 1.0]).unwrap(), (0..32).collect::<Vec<_>>());
    assert_eq!(of([0.25, 0.5]).unwrap(), [10, 11, 12, 13, 14]);
    assert_eq!(of([0.9375, 1.0625]).unwrap(), [0]);
    for (index, support) in [(12, [0.3125, 0.4375]), (0, [0.9375, 1.0625])] {
        assert_eq!(finer.support(index), [support]);
    }
    let short = of([0.3, 0.4]).unwrap_err();
    assert_eq!((&*short.field, short.detail.contains("at least 0.125")), ("u", true), "{short:?}");
    let between = of([0.26, 0.39]).unwrap_err();
    assert!(between.field.is_empty() && between.detail.contains("0.125"), "{between:?}");
    let odd = closed(&around(), 8, 2).unwrap();
    let finer = Finer::new(&odd, &[4]).unwrap();
    // Three poles: the support of a control point is three fine intervals, and the start of the finer curve is half of one ahead.
    let found = ParameterRegion { u: Some([0.25, 0.5]), v: None }.control_points(&finer).unwrap();
    assert_eq!(found.len(), 6);
    for index in found {
        let [[from, to]] = <[_; 1]>::try_from(finer.support(index)).unwrap();
        assert!(
            from >= 0.25 - 1e-12 && to <= 0.5 + 1e-12 && (to - from - 3.0 / 32.0).abs() <= 1e-12,
            "{from} {to}"
        );
    }
}

#[test]
fn twisted_tori_have_blocks_where_their_start_is_not_shifted() {
    for seam in [Seam::Reflected, Seam::HalfTurn] {
        let kinds = || [GeneratorKind::Bspline { degree: 3 }, GeneratorKind::Bspline { degree: 3 }];
        let space = surfaces(Topology::Torus, seam, [7, 6], kinds()).unwrap();
        let places: Vec<Vec<f64>> =
            (0..20).map(|i| vec![i as f64 / 20.0, (7 * i % 20) as f64 / 20.0]).collect();
        assert_flat(&space, [vec![2, 4], vec![3, 2]], &[6, 4], 3, &places);
        let odd = surfaces(Topology::Torus, seam, [7, 6], [around(), GeneratorKind::Bspline { degree: 3 }])
            .unwrap();
        let refused = Finer::new(&odd, &[2, 2]).unwrap_err();
        assert!(matches!(refused, GeometryError::NoRelation { .. }), "{refused}");
    }
    let cubic = closed(&GeneratorKind::Cubic {}, 8, 2).unwrap();
    let wanted = GeometryError::NotRefined { generator: "cubic", factor: 2 };
    assert_eq!(Finer::new(&cubic, &[2]).unwrap_err(), wanted);
    let odd = closed(&around(), 8, 2).unwrap();
    let wanted = GeometryError::NotRefined { generator: "interpolator", factor: 3 };
    assert_eq!(Finer::new(&odd, &[3]).unwrap_err(), wanted);
    let kinds = [GeneratorKind::Bspline { degree: 3 }, GeneratorKind::Bspline { degree: 3 }];
    let sphere = surfaces(Topology::Sphere, Seam::Straight, [7, 6], kinds).unwrap();
    let refused = Finer::new(&sphere, &[2, 1]).unwrap_err().to_string();
    assert!(refused.contains("±2πj") && refused.ends_with("got the factors [2, 1]"), "{refused}");
}

/// Moves of a block change its offsets, handles the coarse control points below them; places say where the control points are.
#[test]
fn edits_move_blocks_and_meet_handles_over_them() {
    let space = open(&half_integer_shifts(PoleList::from_domain(&[[0.0, 0.0]; 3])), 8, 3).unwrap();
    let region = ParameterRegion { u: Some([0.25, 0.75]), v: None };
    let shape = edited(&space, &[4], region, 11);
    let index = shape.blocks[0].indices[3];
    let moves =
        [ControlPointMove { control_point: index, by: vec![0.0, 2.0, 0.0], block: Some(0), normal: None }];
    let handles = [Handle { parameters: vec![0.45], position: vec![3.0, -1.0, 2.0] }];
    let grids = Resolutions::new(&space, [&[4][..]], &[4]).unwrap();
    let edit = Edit::new(&grids, &shape.blocks, &moves, &handles).unwrap();
    let after = edit.apply(&shape).unwrap();
    let found = value(grids.finest().space(), &grids.flatten(&after), &grids.finest().parameters(&[0.45]));
    assert_close("handle", &found, &handles[0].position, 1e-12);
    assert_eq!(after.blocks[0].offsets[(3, 1)], shape.blocks[0].offsets[(3, 1)] + 2.0);
    let described = edit.described(&shape, after.clone());
    let wanted = grids.grid_of(&shape.blocks[0]).support(index);
    assert_eq!(described.supports[0].parameters, wanted);
    assert!(described.l2_change > 0.0 && described.largest_change > 0.0);
    let places = grids.places(&after, &after.blocks[0]).unwrap();
    assert_eq!(places, grids.flatten(&after).select_rows(&after.blocks[0].indices));
    let moves = [
        ControlPointMove { control_point: 0, by: vec![0.0; 3], block: Some(0), normal: None },
        ControlPointMove { control_point: index, by: vec![0.0; 3], block: Some(1), normal: None },
    ];
    let faults = Edit::new(&grids, &shape.blocks, &moves, &[]).unwrap_err();
    let fields: Vec<&str> = faults.iter().map(|fault| &*fault.field).collect();
    assert_eq!(fields, ["moves/0/control_point", "moves/1/block"], "{faults:?}");
}
