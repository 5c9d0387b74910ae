//! The numbers of a merging of LiDAR maps.

use super::{Input, LidarMerging, Pair, decision, place_of};
use backend::verdict::Answer;
use serde::Serialize;
use slam_lidar::merging::MergeMethod;
use slam_lidar::merging::comparison::Difference;
use slam_lidar::merging::verdict::MergeEvidence;

/// The numbers of a merging: what `merge.json` holds.
#[derive(Clone, Debug, Serialize)]
pub struct LidarMergeRecord {
    /// Version of the program.
    pub version: &'static str,
    /// The commit that it was built from, where it is known.
    pub commit: Option<&'static str>,
    /// The kind of the agents' sensors.
    pub sensor: map::SensorKind,
    /// How poses between maps were found.
    pub method: MergeMethod,
    /// The maps given.
    pub inputs: Vec<InputRecord>,
    /// Every two of them.
    #[serde(rename = "encounters")]
    pub pair_results: Vec<PairRecord>,
    /// Names of the inputs that hang together.
    pub groups: Vec<Vec<String>>,
    /// Time and memory.
    pub cost: MergeCost,
    /// The files of results, by names relative to their folder.
    pub files: Vec<String>,
}

/// A map given.
#[derive(Clone, Debug, Serialize)]
pub struct InputRecord {
    /// Its path as given.
    pub path: String,
    /// What it is called.
    pub name: String,
    /// Its keyframes.
    pub keyframes: usize,
    /// Points of their scans.
    pub points: usize,
    /// `world_from_map` as `tx ty tz qx qy qz qw`: its place in the common map.
    pub world_from_map: [f64; 7],
}

/// What came of two maps.
#[derive(Clone, Debug, Serialize)]
pub struct PairRecord {
    /// Their names.
    pub maps: [String; 2],
    /// `accepted`, `undecided` or `refused`.
    pub decision: &'static str,
    /// What is said of them; the first two of the four answers join.
    pub answer: Answer,
    /// Whether they are joined because a person said that both show one place.
    pub confirmed: bool,
    /// The line that decided.
    pub reason: String,
    /// The pose that was judged, with its evidence.
    pub best: Option<EvidenceRecord>,
    /// Other poses that were followed.
    pub rivals: Vec<EvidenceRecord>,
    /// Seconds it took.
    pub seconds: f64,
}

/// What speaks for a pose between two maps.
#[derive(Clone, Debug, Serialize)]
pub struct EvidenceRecord {
    /// The second map in the frame of the first, `tx ty tz qx qy qz qw`.
    pub first_from_second: [f64; 7],
    /// Pieces of one of the maps that come back to this pose when displaced.
    pub pieces: usize,
    /// Of them, those that Scan Context brought here.
    pub finding: usize,
    /// Pieces that map has.
    pub of_pieces: usize,
    /// Share of its points that lie on a surface that the other saw, the lesser of both ways.
    pub overlap: f64,
    /// Share of the surface that the other can judge which is there in both.
    #[serde(rename = "agreeing")]
    pub inlier_ratio: f64,
    /// Share of that which is there in one only.
    pub violated: f64,
    /// Surface that both maps saw and that is there in both, square metres.
    pub shared_m2: f64,
    /// The largest area that one map holds and the other looks through, square metres.
    pub absent_m2: f64,
    /// ln of how much likelier what both saw is of one place than of another that shares things with it.
    pub ln_ratio: f64,
    /// Share of the things that differ.
    pub changed: f64,
    /// Areas that are there in one map only, the largest first, some at most.
    pub differences: Vec<DifferenceRecord>,
    /// Root mean square distance from surfaces, metres.
    pub rmse_m: f64,
    /// Directions of the pose that are weak.
    pub weak: usize,
}

impl EvidenceRecord {
    fn of(evidence: &MergeEvidence, maps: &[String; 2]) -> Self {
        Self {
            first_from_second: evidence.a_from_b.to_tum(),
            pieces: evidence.pieces,
            finding: evidence.finding,
            of_pieces: evidence.of_pieces,
            overlap: evidence.overlap,
            inlier_ratio: evidence.things.inlier_ratio,
            violated: 1.0 - evidence.things.inlier_ratio,
            shared_m2: evidence.things.shared,
            absent_m2: evidence.things.absent(),
            ln_ratio: evidence.weighed.ln_ratio,
            changed: evidence.weighed.changed,
            differences: differences(evidence, maps),
            rmse_m: evidence.rmse,
            weak: evidence.conditioning.weak,
        }
    }
}

/// An area that is there in one map only.
#[derive(Clone, Debug, Serialize)]
pub struct DifferenceRecord {
    /// The map that holds it.
    pub r#in: String,
    /// Its surface, square metres.
    pub area_m2: f64,
    /// Its middle in the frame of the first map, metres.
    pub at: [f64; 3],
}

/// So many areas are listed, of a cell each at least.
const LISTED: usize = 32;

fn differences(evidence: &MergeEvidence, maps: &[String; 2]) -> Vec<DifferenceRecord> {
    let record = |difference: &Difference| DifferenceRecord {
        r#in: maps[usize::from(!difference.in_first)].clone(),
        area_m2: difference.area,
        at: difference.place(&evidence.a_from_b),
    };
    evidence.things.differences.iter().take(LISTED).map(record).collect()
}

/// Time and memory of a merging.
#[derive(Clone, Debug, Default, Serialize)]
pub struct MergeCost {
    /// Seconds for all pairs and the common map.
    pub merge_s: f64,
    /// CPU seconds of the process; who runs the program fills it in, as what follows.
    pub cpu_s: Option<f64>,
    /// Largest resident memory, bytes.
    pub peak_memory_bytes: Option<u64>,
}

impl PairRecord {
    /// The numbers of a pair of `inputs`.
    pub fn of(pair: &Pair, inputs: &[Input]) -> Self {
        let maps = [pair.a, pair.b].map(|input| inputs[input].name.clone());
        let evidence = |evidence: &MergeEvidence| EvidenceRecord::of(evidence, &maps);
        Self {
            decision: decision(pair),
            answer: pair.answer(),
            confirmed: pair.is_confirmed(),
            reason: pair.reason(),
            best: pair.verdict.best.as_ref().map(evidence),
            rivals: pair.verdict.rivals.iter().map(evidence).collect(),
            seconds: pair.seconds,
            maps: maps.clone(),
        }
    }
}

impl LidarMergeRecord {
    /// The numbers of a merging of `inputs`.
    pub fn of(inputs: &[Input], merging: &LidarMerging) -> Self {
        let name = |input: usize| inputs[input].name.clone();
        let input = |(index, input): (usize, &Input)| InputRecord {
            path: input.path.display().to_string(),
            name: input.name.clone(),
            keyframes: input.keyframes.len(),
            points: input.keyframes.iter().map(|keyframe| keyframe.points.len()).sum(),
            world_from_map: place_of(merging, index).to_tum(),
        };
        Self {
            version: env!("CARGO_PKG_VERSION"),
            commit: crate::program::commit(),
            sensor: map::SensorKind::Lidar,
            method: merging.method,
            inputs: inputs.iter().enumerate().map(input).collect(),
            pair_results: merging.pairs.iter().map(|pair| PairRecord::of(pair, inputs)).collect(),
            groups: merging.groups.iter().map(|g| g.members.iter().map(|&m| name(m)).collect()).collect(),
            cost: MergeCost { merge_s: merging.seconds, ..MergeCost::default() },
            files: Vec::new(),
        }
    }
}
