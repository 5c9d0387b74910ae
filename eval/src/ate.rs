//! Absolute trajectory error.

use crate::{Associated, Statistics};

/// Distances between estimated and true positions, in the unit of the ground truth (Sturm 2012, §IV-B); `None` without
/// pairs. Align first. [`Statistics::rmse`] of them is Eq. 12 of EMR-FLOAM.
pub fn ate(aligned: &Associated) -> Option<Statistics> {
    let (estimate, truth) = aligned.positions();
    let errors: Vec<f64> = estimate.iter().zip(&truth).map(|(e, t)| (e - t).norm()).collect();
    Statistics::of(&errors)
}
