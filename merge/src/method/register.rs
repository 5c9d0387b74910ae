//! The clouds of a pair registered from a guess, with the information the paper gives them.

use super::{MethodRefusal, Observed};
use crate::estimate::Estimate;
use crate::icp::{self, IcpParams};
use geometry::Sim3;
use map::KeyframeId;

/// Registers the target's cloud onto the source's from `target_from_source` (Eq. 8 and §IV-D2) and gives
/// target_from_source with the information of Eq. 2–3.
///
/// Scaling the source beforehand, as the paper does, and keeping the guess's scale are the same. Of the scale the
/// registration knows nothing; its variance, `log_scale_variance` of ln σ, is the scale filter's.
pub(super) fn register(
    observed: &Observed,
    (source, target): (KeyframeId, KeyframeId),
    target_from_source: &Sim3,
    log_scale_variance: f64,
    params: &IcpParams,
) -> Result<Estimate, MethodRefusal> {
    let clouds = observed.source.clouds.get(&source).zip(observed.target.clouds.get(&target));
    let (source, target) = clouds.ok_or(MethodRefusal::NoMotion)?;
    let registration = icp::register(target, source, &target_from_source.inverse(), params)
        .map_err(MethodRefusal::Registration)?;
    let mut information = registration.information;
    information[(6, 6)] += log_scale_variance.recip();
    Ok(Estimate { a_from_b: registration.target_from_source, information }.inverse())
}
