//! Clouds and maps into one frame (Loop-box, §IV-D1, §IV-E, Eqs. 6–9).
//!
//! # Frames
//! `source` and `target` are the camera frames of the keyframes i and j, each in its keyframe's unit;
//! `source_world` and `target_world` those of the two maps. Scaling the source by σ* (target keyframe units per
//! source keyframe unit) gives the frames `scaled_source` and `scaled_source_world`: the same axes, but the
//! target's unit. A keyframe's pose may itself carry a unit (`world_from_keyframe.scale`); all poses here are
//! therefore in Sim(3), and the paper's equations hold with them as they stand.
//!
//! Eq. 7 puts points of the *target* world through the pose of the *source* keyframe, as if both worlds were one.
//! That is no frame of either camera; we call it `assumed_source`. The initial guess (Eq. 8) leads from there to
//! `scaled_source`, so it is not the relative pose of the two cameras but what [`initial_guess`] makes of it.

#[cfg(test)]
mod tests;

use crate::estimate::Estimate;
use geometry::{Se3, Sim3};
use map::{AgentId, Map};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The poses of the two keyframes of a loop closure in their worlds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairPoses {
    /// wTs(i): pose and unit of keyframe i in the source's world.
    pub source_world_from_source: Sim3,
    /// wTt(j): pose and unit of keyframe j in the target's world.
    pub target_world_from_target: Sim3,
}

/// Both clouds in the frame `scaled_source`, target keyframe units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AlignedClouds {
    /// \*P_s: the source cloud times σ* (§IV-D).
    pub source: Vec<Vector3<f64>>,
    /// +P_t: the target cloud after the initial guess (Eq. 8).
    pub target: Vec<Vector3<f64>>,
}

/// What brings both maps into the one world `scaled_source_world` (§IV-E).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldMotions {
    /// For the source map: the scaling about its world's origin.
    pub scaled_source_world_from_source_world: Sim3,
    /// For the target map.
    pub scaled_source_world_from_target_world: Sim3,
}

impl PairPoses {
    /// Eqs. 6 and 7: `s(i)Tw ∘ t(j)Tw⁻¹`, assumed_source_from_target.
    pub fn assumed_source_from_target(&self) -> Sim3 {
        self.source_world_from_source.inverse() * self.target_world_from_target
    }

    /// target_world_from_source_world of an estimate between the keyframes, target_from_source; nothing where a pose is no number.
    pub fn of_worlds(&self, target_from_source: &Estimate) -> Option<Estimate> {
        target_from_source.carried(&self.target_world_from_target, &self.source_world_from_source.inverse())
    }
}

/// T_IG of Eqs. 8 and 9, scaled_source_from_assumed_source.
///
/// `target_from_scaled_source` is the pair's relative pose: R of the matched images and t of the
/// [scale filter](crate::scale_filter), target keyframe units.
pub fn initial_guess(target_from_scaled_source: &Se3, poses: &PairPoses) -> Sim3 {
    Sim3::from(target_from_scaled_source.inverse()) * poses.assumed_source_from_target().inverse()
}

/// Eqs. 6–8 and the scaling before them: both clouds into the frame `scaled_source`.
///
/// `source` and `target` are the clouds in their keyframes' camera frames and units, as `Keyframe::cloud` gives
/// them; `scale` is σ*, `initial_guess` T_IG.
pub fn align(
    source: &[Vector3<f64>],
    target: &[Vector3<f64>],
    scale: f64,
    initial_guess: &Sim3,
    poses: &PairPoses,
) -> AlignedClouds {
    let scaled_source_from_target = *initial_guess * poses.assumed_source_from_target();
    AlignedClouds {
        source: source.iter().map(|point| point * scale).collect(),
        target: target.iter().map(|&point| scaled_source_from_target * point).collect(),
    }
}

/// Eq. 9: `sT*t = T_Ftrans ∘ T_IG ∘ s(i)Tw ∘ t(j)Tw⁻¹`, scaled_source_from_target.
///
/// `refinement` is T_Ftrans: what registration moves `AlignedClouds::target` by to lie on
/// `AlignedClouds::source`. The result maps points of the *keyframe* j, not of the target's world;
/// [`world_motions`] makes of it what moves the maps.
pub fn final_transform(refinement: &Sim3, initial_guess: &Sim3, poses: &PairPoses) -> Sim3 {
    *refinement * *initial_guess * poses.assumed_source_from_target()
}

/// The motions of both maps (§IV-E) from σ* and sT*t of [`final_transform`].
///
/// The source's world is scaled by σ*, and the target's placed in it so that keyframe j stands to keyframe i as
/// `final_transform` says. The paper leaves the step from keyframe frames to worlds unsaid.
pub fn world_motions(scale: f64, final_transform: &Sim3, poses: &PairPoses) -> WorldMotions {
    let scaling = Sim3 { scale, ..Sim3::identity() };
    // The scaled keyframe's pose: its points and its world are both in the new unit.
    let scaled_source_world_from_scaled_source = scaling * poses.source_world_from_source * scaling.inverse();
    WorldMotions {
        scaled_source_world_from_source_world: scaling,
        scaled_source_world_from_target_world: scaled_source_world_from_scaled_source
            * *final_transform
            * poses.target_world_from_target.inverse(),
    }
}

/// Moves agents' maps into another world: the pose and unit of every keyframe of an agent by the agent's motion;
/// agents without one stay.
///
/// All else in a map is relative to its keyframes and stays: inverse depths and points are in the keyframes'
/// units, frames relative to their keyframes, and so are edges between two keyframes of one agent, whose residuals no
/// common motion changes. The motions must be valid (`Sim3::is_valid`).
pub fn apply(map: &mut Map, new_world_from_agent: &BTreeMap<AgentId, Sim3>) {
    for keyframe in map.keyframes.values_mut() {
        if let Some(motion) = new_world_from_agent.get(&keyframe.agent) {
            keyframe.world_from_keyframe = *motion * keyframe.world_from_keyframe;
        }
    }
}
