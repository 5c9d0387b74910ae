//! The lens as unknowns of the joint optimisation.

use super::pairs::Relative;
use super::problem::{Problem, WindowPoint};
use crate::lens::{Lens, TERMS};
use nalgebra::{Matrix2, SMatrix, Vector2};

/// A problem's lens and what the images show; [`Problem::set_lens`] derives rays and pixels from it.
#[derive(Clone, Debug)]
pub(crate) struct Calibration {
    /// The lens as it stands.
    pub lens: Lens,
    /// Standard deviations of its terms before anything is seen: how well the camera was calibrated.
    pub sigma: [f64; TERMS],
    /// Host pixel of each point in the image.
    pub hosts: Vec<[f64; 2]>,
    /// Pixel of each observation in the image, and its information there.
    pub seen: Vec<([f64; 2], [f64; 3])>,
}

/// Derivative of a residual by the lens's terms, a column each.
pub(super) type ByTerms = SMatrix<f64, 2, TERMS>;

impl Calibration {
    /// What the terms cost: they are a priori zero.
    pub fn prior_cost(&self) -> f64 {
        self.lens.terms.iter().zip(&self.sigma).map(|(term, sigma)| (term / sigma).powi(2)).sum()
    }

    /// Derivative by the terms of an observation's residual, brought back to pixels of the image: a lens that makes the
    /// image smaller does not make its errors smaller.
    pub fn by_terms(
        &self,
        problem: &Problem,
        relative: &Relative,
        (index, point): (usize, &WindowPoint),
        observation: usize,
        residual: &[f64; 2],
    ) -> ByTerms {
        let camera = &problem.camera;
        let x = relative.transform(&point.ray, point.inverse_depth);
        let iz = 1.0 / x.z;
        let (px, py) = (x.x * iz, x.y * iz);
        let host = self.lens.by_terms(self.hosts[index]);
        let shown = self.seen[observation].0;
        let seen = self.lens.by_terms(shown);
        let magnification = self.lens.magnification_by_terms(shown);
        let residual = Vector2::from(*residual);
        let columns: [Vector2<f64>; TERMS] = std::array::from_fn(|k| {
            let ray = relative.rotation.column(0) * (host[k].x / camera.fx)
                + relative.rotation.column(1) * (host[k].y / camera.fy);
            let predicted =
                Vector2::new(camera.fx * iz * (ray.x - px * ray.z), camera.fy * iz * (ray.y - py * ray.z));
            predicted - seen[k] - magnification[k] * residual
        });
        ByTerms::from_columns(&columns)
    }
}

impl Problem {
    /// Derives rays, pixels and information from a lens with these terms; nothing without a calibration.
    pub fn set_lens(&mut self, terms: [f64; TERMS]) {
        let Some(calibration) = &mut self.calibration else { return };
        calibration.lens.terms = terms;
        let lens = &calibration.lens;
        for (point, &shown) in self.points.iter_mut().zip(&calibration.hosts) {
            point.ray = lens.ray(shown);
        }
        for (observation, &(shown, [a, b, c])) in self.observations.iter_mut().zip(&calibration.seen) {
            observation.pixel = lens.undistort(shown);
            let Some(back) = lens.magnification(shown).try_inverse() else { continue };
            let information = back.transpose() * Matrix2::new(a, b, b, c) * back;
            observation.information = [information[(0, 0)], information[(0, 1)], information[(1, 1)]];
        }
    }
}
