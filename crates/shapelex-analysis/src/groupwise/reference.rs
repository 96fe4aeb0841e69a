//! Correspondence of a new shape with a distribution that stays as it is.

use super::domain::Domain;
use super::member::{Member, Penalty, free};
use super::model::Model;
use super::{AnalysisError, Corresponding, GroupwiseOptions, NO_VARIANCE, NOISE, finished};
use crate::watch::Watch;
use shapelex_geometry::reparametrisation::Reparametrisation;
use shapelex_geometry::reparametrisation::flow::Workspace;
use shapelex_geometry::reparametrisation::spherical::Spherical;
use shapelex_geometry::rotation::Rotation;
use shapelex_numeric::dense::{Matrix, leading_eigenpairs, multiply, transpose_multiply};

/// A mean with modes, to which shapes are brought into correspondence one at a time.
#[derive(Debug)]
pub struct Reference {
    spherical: Spherical,
    domain: Domain,
    /// Points of the mean at the nodes, centred.
    points: Vec<[f64; 3]>,
    mean: Vec<f64>,
    /// Directions of variance with their variances.
    vectors: Matrix,
    variances: Vec<f64>,
    area: f64,
}

impl Reference {
    /// From the control points of the mean, and the displacement of each mode by one standard deviation, `N × 3` each.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] or [`AnalysisError::Degenerate`] for a mean without extent in some direction.
    pub fn new(
        spherical: &Spherical,
        mean: &Matrix,
        displacements: &[Matrix],
    ) -> Result<Self, AnalysisError> {
        let domain = Domain::new();
        let member = Member::new(&domain, spherical.shape(mean))?;
        let points = member.placed(&domain);
        let area = member.area(&domain);
        let mut columns = Matrix::zeros(3 * Domain::SIZE, displacements.len());
        for (k, displacement) in displacements.iter().enumerate() {
            let mut work = Workspace::new(0);
            let (shape, still) = (spherical.shape(displacement), Reparametrisation::default());
            let mut values = Matrix::zeros(Domain::NODES, 3);
            for (q, x) in domain.nodes.points.iter().enumerate() {
                let point = shape.point(still.apply(*x, &mut work));
                (0..3).for_each(|c| values[(q, c)] = point[c]);
            }
            columns.column_mut(k).copy_from_slice(domain.coefficients(&mut values).as_slice());
        }
        // The modes are orthogonal in the metric of the space, not in that of the area of the sphere.
        let pairs = leading_eigenpairs(&transpose_multiply(&columns, &columns), displacements.len())?;
        let least = pairs.values.first().copied().unwrap_or(0.0) * 1e-12;
        let rank = pairs.values.iter().take_while(|value| **value > least).count();
        let mut vectors = multiply(&columns, &pairs.vectors.columns(0, rank).into_owned());
        for (mut column, variance) in vectors.column_iter_mut().zip(&pairs.values) {
            column /= variance.sqrt();
        }
        let variances = pairs.values[..rank].to_vec();
        Ok(Self {
            spherical: spherical.clone(),
            domain,
            points,
            mean: member.coefficients,
            vectors,
            variances,
            area,
        })
    }

    /// Brings a shape (`N × 3` control points) into correspondence: the best rotation, then steps of rising degree. Its size is
    /// that of the mean meanwhile.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] or [`AnalysisError::Degenerate`] with index 0; [`AnalysisError::Interrupted`].
    pub fn correspond(
        &self,
        rows: &Matrix,
        options: &GroupwiseOptions,
        watch: &dyn Watch,
    ) -> Result<Corresponding, AnalysisError> {
        let domain = &self.domain;
        let mut member = Member::new(domain, self.spherical.shape(rows))?;
        member.scale = (self.area / member.area(domain)).sqrt();
        member.settle(domain);
        let isotropic = Model::isotropic(self.mean.clone());
        member.search(domain, &self.points, &isotropic);
        watch.check()?;
        let size: f64 = self.mean.iter().map(|x| x * x).sum();
        let total = self.variances.iter().sum::<f64>().max(NO_VARIANCE * size);
        let last = (options.degree * options.rounds).saturating_sub(1).max(1) as f64;
        for round in 0..options.degree * options.rounds {
            watch.check()?;
            let share = NOISE[0] * (NOISE[1] / NOISE[0]).powf(round as f64 / last);
            let delta = share * total;
            let model = Model::of(self.mean.clone(), self.vectors.clone(), &self.variances, delta);
            let degree = 1 + round / options.rounds.max(1);
            member.map = member.map.raised(degree);
            let penalty = Penalty { weight: options.stiffness * total * share / NOISE[0] };
            member.step(domain, &model, &free(degree), penalty);
        }
        let mut map = member.map.clone();
        map.inner = Rotation::NONE;
        Ok(finished(domain, &self.spherical, &member, map))
    }
}
