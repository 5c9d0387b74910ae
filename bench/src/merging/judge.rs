//! What two maps have in common by the true poses, and whether their merge is right.

use super::maps::MapWithTruth;
use super::program::{Merged, PairResult};
use super::truth::{Deviation, Side, growth};
use anyhow::{Context, Result};
use eval::DEFAULT_MAX_DIFF;
use map::Map;
use measuring::shared::{NEAR, shared_length};
use measuring::views::{DIFFERENT, SAME, View, largest_overlap};

use super::cases::Common;

/// Two maps that share so much path and a view are missed when they are not merged, metres.
pub const ENOUGH: f64 = 2.0;

/// A map to merge, whole or a part, and the map with known truth that it comes from.
pub struct Part<'a> {
    /// What it comes from, whose world and unit are its own.
    pub known: &'a MapWithTruth,
    /// The map.
    pub map: &'a Map,
}

/// What became of a pair.
#[derive(Clone, Debug)]
pub enum Verdict {
    /// Merged, as the truth has it.
    Right(Deviation),
    /// Merged, but not so.
    Wrong(Deviation),
    /// Not merged, for this reason.
    Refused(String),
}

/// A pair of maps, what they share, and what became of them.
#[derive(Clone, Debug)]
pub struct ScoredPair {
    /// What it is.
    pub name: String,
    /// What they share.
    pub common: Common,
    /// What became of them.
    pub verdict: Verdict,
}

impl ScoredPair {
    /// Whether the two show a place alike.
    pub fn is_related(&self) -> bool {
        self.common.overlap >= SAME
    }

    /// Whether the two show nothing in common.
    pub fn are_strangers(&self) -> bool {
        self.common.overlap < DIFFERENT
    }

    /// Whether they were not merged though they share enough.
    pub fn is_missed(&self) -> bool {
        matches!(self.verdict, Verdict::Refused(_)) && self.is_related() && self.common.metres >= ENOUGH
    }
}

impl<'a> Part<'a> {
    /// What the keyframes see.
    fn views(&self) -> Vec<View> {
        let own = |view: &&View| self.map.keyframes.contains_key(&view.keyframe);
        self.known.views.iter().filter(own).cloned().collect()
    }

    /// What it shares with another.
    pub fn common(&self, other: &Part<'a>) -> Common {
        if !measuring::share_world(&self.known.sequence, &other.known.sequence) {
            return Common { overlap: 0.0, metres: 0.0 };
        }
        let (path, others) = (self.known.true_path(self.map), other.known.true_path(other.map));
        Common {
            overlap: largest_overlap(&self.views(), &other.views()),
            metres: shared_length(&path, &others, NEAR),
        }
    }

    /// Its side of a merge, met at `time`; it is number `input` there.
    fn side(&self, merged: &Merged, input: usize, time: f64) -> Result<Side> {
        let missing = || format!("{}: no pose at {time} s", self.known.sequence);
        let common = merged.trajectory(input)?;
        let own = self.map.trajectory();
        let pairs = own.iter().filter_map(|pose| {
            let there = common.pose_at(pose.timestamp, DEFAULT_MAX_DIFF)?;
            Some((pose.world_from_camera.translation, there.translation))
        });
        let (before, after): (Vec<_>, Vec<_>) = pairs.unzip();
        Ok(Side {
            common_from_camera: common.pose_at(time, DEFAULT_MAX_DIFF).with_context(missing)?.rigid(),
            world_from_camera: self
                .known
                .truth
                .pose_at(time, DEFAULT_MAX_DIFF)
                .with_context(missing)?
                .rigid(),
            growth: growth(&before, &after),
            metres: self.known.metres,
        })
    }

    /// Median depth of what the keyframe of a time sees, metres.
    fn depth(&self, time: f64) -> Result<f64> {
        let found = self.known.views.iter().find(|view| (view.timestamp - time).abs() <= DEFAULT_MAX_DIFF);
        found
            .map(|view| view.depth)
            .with_context(|| format!("{}: no keyframe at {time} s", self.known.sequence))
    }
}

/// What became of a pair of inputs in a merge.
///
/// # Errors
/// When the results lack what is needed to judge.
pub fn judge(merged: &Merged, pair: &PairResult, [target, source]: [&Part; 2]) -> Result<Verdict> {
    let Some([target_time, source_time]) = pair.met else {
        return Ok(Verdict::Refused(pair.refusal.clone().unwrap_or_default()));
    };
    if !measuring::share_world(&target.known.sequence, &source.known.sequence) {
        let nowhere = f64::INFINITY;
        return Ok(Verdict::Wrong(Deviation { rotation: nowhere, offset: nowhere, scale: nowhere }));
    }
    let target_side = target.side(merged, pair.target, target_time)?;
    let source_side = source.side(merged, pair.source, source_time)?;
    let found = Deviation::new(&target_side, &source_side, target.depth(target_time)?);
    Ok(if found.is_right() { Verdict::Right(found) } else { Verdict::Wrong(found) })
}
