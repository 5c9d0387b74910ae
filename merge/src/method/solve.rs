//! The baselines, as functions of what was measured.

use super::graph::{Bond, optimised};
use super::register::register;
use super::{
    Baseline, BaselineParams, Configuration, Measurement, MethodRefusal, Observed, ObservedPair, Placement,
};
use crate::estimate::Estimate;
use crate::optimal_scale::{Neighbourhood, PairEstimate, algorithm_1, volume_ratio};
use crate::pair::PairRefusal;
use crate::scale_filter::ScaleRefusal;
use geometry::Sim3;
use map::KeyframeId;
use nalgebra::SMatrix;
use rayon::prelude::*;

/// Joins two maps by `baseline`, from what was measured for it.
///
/// # Errors
/// When the pairs it rests on were not measured or cannot be registered, or make no motion.
pub fn solve(
    baseline: Baseline,
    observed: &Observed,
    params: &BaselineParams,
) -> Result<Placement, MethodRefusal> {
    match baseline {
        Baseline::PcrPro => pcr_pro(observed),
        Baseline::PoseGraph(configuration) => pose_graph(configuration, observed, params),
        Baseline::LoopBox => loop_box(observed, params),
    }
}

/// PCR-Pro of the centre pair.
fn pcr_pro(observed: &Observed) -> Result<Placement, MethodRefusal> {
    let centre = observed.direct[1].as_ref().ok_or(MethodRefusal::NoMotion)?;
    let measured = centre.measured.as_ref().map_err(|refusal| MethodRefusal::NotMeasured(*refusal))?;
    let target_from_source = measured.estimate().ok_or(MethodRefusal::NoMotion)?;
    Ok(Placement { source: centre.source, target: centre.target, target_from_source })
}

/// Loop-box as the paper has it: Algorithm 1, one pair of three, ICP.
fn loop_box(observed: &Observed, params: &BaselineParams) -> Result<Placement, MethodRefusal> {
    let (pair, measured) = observed.most_matched().ok_or_else(|| not_measured(observed))?;
    let (source, target) = observed.poses(pair.source, pair.target).ok_or(MethodRefusal::NoMotion)?;
    let scales = scales(observed);
    let scale = algorithm_1(&scales, centre_volume_ratio(observed), &params.optimal_scale)?;
    let guess = Sim3 { scale: scale.scale * source.scale / target.scale, ..measured.target_from_source() };
    let log_variance = scale.variance / (scale.scale * scale.scale);
    let place = (pair.source, pair.target);
    let target_from_source = register(observed, place, &guess, log_variance, &params.icp)?;
    Ok(Placement { source: pair.source, target: pair.target, target_from_source })
}

/// The refusal of the centre pair, or of none.
fn not_measured(observed: &Observed) -> MethodRefusal {
    let centre = observed.direct[1].as_ref().and_then(|pair| pair.measured.as_ref().err().copied());
    let none = PairRefusal::Scale(ScaleRefusal::TooFew { given: 0, needed: 1 });
    MethodRefusal::NotMeasured(centre.unwrap_or(none))
}

/// σ_z in target world units per source world unit.
fn scales(observed: &Observed) -> Neighbourhood {
    observed.direct.each_ref().map(|pair| {
        let pair = pair.as_ref()?;
        let measured = pair.measured.as_ref().ok()?;
        let (source, target) = observed.poses(pair.source, pair.target)?;
        let world = target.scale / source.scale;
        Some(PairEstimate {
            scale: measured.scale.scale * world,
            variance: measured.scale.variance * world * world,
            match_count: measured.match_count,
        })
    })
}

/// r_vol of the centre pair; 1, which lets the neighbours count, where there is none.
fn centre_volume_ratio(observed: &Observed) -> f64 {
    let ratio = || {
        let centre = observed.direct[1].as_ref()?;
        let measured = centre.measured.as_ref().ok()?;
        let source = observed.source.clouds.get(&centre.source)?;
        let target = observed.target.clouds.get(&centre.target)?;
        volume_ratio(&source.points, &target.points, &measured.target_from_source())
    };
    ratio().unwrap_or(1.0)
}

/// A pose graph of Appendix A.
fn pose_graph(
    configuration: Configuration,
    observed: &Observed,
    params: &BaselineParams,
) -> Result<Placement, MethodRefusal> {
    let centre = observed.direct[1].as_ref().ok_or(MethodRefusal::NoMotion)?;
    let (top, measured) = observed.most_matched().ok_or_else(|| not_measured(observed))?;
    let best = bond(observed, top, measured, params).ok_or(MethodRefusal::NoMotion)?;
    let (source, target) = observed.poses(top.source, top.target).ok_or(MethodRefusal::NoMotion)?;
    let motion = target * best.target_from_source.a_from_b * source.inverse();
    let bonds = match configuration {
        Configuration::Top => top_bonds(observed, best, &motion, measured.log_scale_variance(), params),
        Configuration::Straight | Configuration::Full => own_bonds(observed, best, params),
    };
    let middle = (centre.source, centre.target);
    let relative = optimised(observed, &bonds, middle, &motion, &params.pose_graph)?;
    let information = information(observed, &bonds, middle).ok_or(MethodRefusal::NoMotion)?;
    let target_from_source = Estimate { a_from_b: relative, information };
    Ok(Placement { source: centre.source, target: centre.target, target_from_source })
}

/// A pair's own transformation: PCR-Pro and ICP, or PCR-Pro alone where ICP refuses.
fn bond(
    observed: &Observed,
    pair: &ObservedPair,
    measured: &Measurement,
    params: &BaselineParams,
) -> Option<Bond> {
    let place = (pair.source, pair.target);
    let (start, variance) = (measured.target_from_source(), measured.log_scale_variance());
    let registered = register(observed, place, &start, variance, &params.icp).ok();
    let target_from_source = registered.or_else(|| measured.estimate())?;
    Some(Bond { source: pair.source, target: pair.target, target_from_source })
}

/// Straight and fully connected: every measured pair by its own transformation. `best` is one of them, done before.
fn own_bonds(observed: &Observed, best: Bond, params: &BaselineParams) -> Vec<Bond> {
    let done = (best.source, best.target);
    let pairs: Vec<&ObservedPair> = observed.direct.iter().flatten().chain(&observed.cross).collect();
    let others: Vec<Option<Bond>> = pairs
        .into_par_iter()
        .filter(|pair| (pair.source, pair.target) != done)
        .map(|pair| bond(observed, pair, pair.measured.as_ref().ok()?, params))
        .collect();
    std::iter::once(best).chain(others.into_iter().flatten()).collect()
}

/// Top matches: every direct pair registered from where the one transformation `motion`,
/// target_world_from_source_world, puts it.
fn top_bonds(
    observed: &Observed,
    best: Bond,
    motion: &Sim3,
    log_scale_variance: f64,
    params: &BaselineParams,
) -> Vec<Bond> {
    let done = (best.source, best.target);
    let others: Vec<Option<Bond>> = observed
        .direct
        .par_iter()
        .flatten()
        .filter(|pair| (pair.source, pair.target) != done)
        .map(|pair| {
            let place = (pair.source, pair.target);
            let (source, target) = observed.poses(pair.source, pair.target)?;
            let start = target.inverse() * *motion * source;
            let target_from_source =
                register(observed, place, &start, log_scale_variance, &params.icp).ok()?;
            Some(Bond { source: pair.source, target: pair.target, target_from_source })
        })
        .collect();
    std::iter::once(best).chain(others.into_iter().flatten()).collect()
}

/// The mean information of the bonds, seen at the middle keyframes through the maps' own poses. The mean, not the
/// sum: neighbouring keyframes share the errors of their depths.
fn information(
    observed: &Observed,
    bonds: &[Bond],
    (source, target): (KeyframeId, KeyframeId),
) -> Option<SMatrix<f64, 7, 7>> {
    let (source, target) = observed.poses(source, target)?;
    let mut sum = SMatrix::zeros();
    for bond in bonds {
        let (s, t) = observed.poses(bond.source, bond.target)?;
        let carried = bond.target_from_source.carried(&(target.inverse() * t), &(s.inverse() * source))?;
        sum += carried.information / bonds.len() as f64;
    }
    Some(sum)
}
