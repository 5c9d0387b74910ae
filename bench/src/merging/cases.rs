//! The merges whose errors are measured.

use super::maps::{MapWithTruth, Recording};
use super::program::{Attempt, Merged, Program};
use anyhow::Result;
use measuring::shared::{NEAR, shared_length};
use measuring::views::largest_overlap;
use std::path::{Path, PathBuf};

/// Maps to merge, and what is to be reached.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Its folder.
    pub name: &'static str,
    /// What is special about it.
    pub what: &'static str,
    /// The recordings in the order of the command; the first one is aligned with the truth.
    pub recordings: &'static [Recording<'static>],
    /// Largest error of another agent, metres.
    pub reach: f64,
    /// Largest error of the scale, percent.
    pub reach_percent: Option<f64>,
    /// Whether the methods are compared on it.
    pub compared: bool,
}

const A: Recording = Recording::whole("parking_a");
const B: Recording = Recording::whole("parking_b");
const C: Recording = Recording::whole("parking_c");

/// The merges. The four states of the paper's Fig. 2 are `same` (a), `same-once` (b), `opposite` (c) and `opposite-once` (d); the
/// cuts leave less than 2 m in common.
pub const CASES: [Case; 8] = [
    Case {
        name: "same",
        what: "same direction",
        recordings: &[A, B],
        reach: 0.10,
        reach_percent: Some(0.3),
        compared: true,
    },
    Case {
        name: "opposite",
        what: "opposite directions",
        recordings: &[A, C],
        reach: 0.12,
        reach_percent: Some(0.3),
        compared: true,
    },
    Case {
        name: "same-once",
        what: "same direction, one closure, at the end and the beginning",
        recordings: &[Recording::to("parking_a", 16.0), B],
        reach: 0.25,
        reach_percent: Some(1.0),
        compared: true,
    },
    Case {
        name: "same-once-late",
        what: "same direction, one closure, at the end and the beginning of a part",
        recordings: &[A, Recording::from("parking_b", 6.0)],
        reach: 0.25,
        reach_percent: Some(1.0),
        compared: false,
    },
    Case {
        name: "opposite-once",
        what: "opposite directions, one closure, one-sided",
        recordings: &[Recording::from("parking_a", 6.2), C],
        reach: 0.25,
        reach_percent: Some(1.0),
        compared: true,
    },
    Case {
        name: "opposite-once-late",
        what: "opposite directions, one closure, one-sided, from the other agent",
        recordings: &[A, Recording::from("parking_c", 6.2)],
        reach: 0.25,
        reach_percent: Some(1.0),
        compared: false,
    },
    Case {
        name: "chain",
        what: "the outer two meet only the one between",
        recordings: &[Recording::to("parking_b", 13.0), A, C],
        reach: 0.20,
        reach_percent: None,
        compared: false,
    },
    Case {
        name: "desk",
        what: "hand-held",
        recordings: &[Recording::whole("tum_fr1_xyz"), Recording::whole("tum_fr1_desk")],
        reach: 0.04,
        reach_percent: Some(2.0),
        compared: true,
    },
];

/// What came of a case.
pub struct Measured {
    /// The case.
    pub case: Case,
    /// What each two of the recordings share, in the order of the command.
    pub common: Vec<Common>,
    /// The numbers, or why there are none.
    pub result: Result<Numbers, String>,
}

/// What two recordings share by their true poses.
#[derive(Clone, Copy, Debug)]
pub struct Common {
    /// The largest overlap of two keyframes, 0–1.
    pub overlap: f64,
    /// Length of path, metres.
    pub metres: f64,
}

/// The numbers of a merge.
#[derive(Clone, Copy, Debug)]
pub struct Numbers {
    /// The largest ATE RMSE of an agent but the first, metres.
    pub error: f64,
    /// The largest error of such an agent's scale, percent; nothing where no path shows it.
    pub scale_percent: Option<f64>,
    /// Seconds for the merge, without files and features; the median of several.
    pub seconds: Option<f64>,
    /// Milliseconds for the features of a keyframe.
    pub features_ms: Option<f64>,
    /// Largest resident memory, bytes.
    pub memory: Option<f64>,
}

impl Case {
    /// Whether all sequences it needs are among those.
    pub fn is_possible(&self, sequences: &[String]) -> bool {
        self.recordings.iter().all(|recording| sequences.iter().any(|name| name == recording.sequence))
    }

    /// The recordings as people read them.
    pub fn title(&self) -> String {
        self.recordings.iter().map(ToString::to_string).collect::<Vec<_>>().join(" + ")
    }

    /// Merges `repeats` times and measures. The results of a merge that falls short stay in `work`.
    ///
    /// # Errors
    /// When files cannot be read; a merge that is refused or fails is told in the result.
    pub fn measure(&self, program: &Program, data: &Path, work: &Path, repeats: usize) -> Result<Measured> {
        let result =
            (0..repeats.max(1)).map(|_| self.merge(program, data, work, None)).collect::<Result<_>>();
        let result = result.map_err(|error| format!("{error:#}")).map(middle);
        Ok(Measured { case: *self, common: self.common(data, work)?, result })
    }

    /// Merges once by a method.
    ///
    /// # Errors
    /// When the maps are not merged, or the program fails.
    pub fn merge(
        &self,
        program: &Program,
        data: &Path,
        work: &Path,
        method: Option<&str>,
    ) -> Result<Numbers> {
        let maps: Vec<PathBuf> = self.recordings.iter().map(|recording| recording.map(work)).collect();
        match program.merge(&maps, &self.folder(work, method), method)? {
            Attempt::Refused(reasons) => anyhow::bail!("refused: {}", reasons.join("; ")),
            Attempt::Merged(merged) => {
                let numbers = self.numbers(program, &merged, data)?;
                // A map and a cloud of hundreds of megabytes are kept where someone will want to see them.
                if method.is_some() || numbers.reaches(self) {
                    merged.remove()?;
                }
                Ok(numbers)
            }
        }
    }

    /// Where its results lie.
    fn folder(&self, work: &Path, method: Option<&str>) -> PathBuf {
        work.join("merges")
            .join(method.map_or(self.name.to_owned(), |method| format!("{}-{method}", self.name)))
    }

    fn numbers(&self, program: &Program, merged: &Merged, data: &Path) -> Result<Numbers> {
        let errors = program.errors(merged, self.recordings, data)?;
        let scales = errors.iter().filter_map(|error| Some(error.scale_percent?.abs()));
        let inputs = 0..self.recordings.len();
        let keyframes: Option<f64> = inputs.map(|i| merged.number(&format!("/inputs/{i}/keyframes"))).sum();
        Ok(Numbers {
            error: errors.iter().map(|error| error.rmse).fold(0.0, f64::max),
            scale_percent: scales.reduce(f64::max),
            seconds: merged.number("/cost/merge_s"),
            features_ms: keyframes.and_then(|count| Some(1e3 * merged.number("/cost/features_s")? / count)),
            memory: merged.number("/cost/peak_memory_bytes"),
        })
    }

    /// What each two of the recordings share.
    fn common(&self, data: &Path, work: &Path) -> Result<Vec<Common>> {
        let known =
            |recording: &Recording| MapWithTruth::read(recording.sequence, &recording.map(work), data);
        let maps = self.recordings.iter().map(known).collect::<Result<Vec<_>>>()?;
        let paths =
            self.recordings.iter().map(|recording| recording.true_path(data)).collect::<Result<Vec<_>>>()?;
        let pairs = (0..maps.len()).flat_map(|a| (a + 1..maps.len()).map(move |b| (a, b)));
        let common = |(a, b): (usize, usize)| Common {
            overlap: largest_overlap(&maps[a].views, &maps[b].views),
            metres: shared_length(&paths[a], &paths[b], NEAR),
        };
        Ok(pairs.map(common).collect())
    }
}

impl Numbers {
    /// Whether it is as good as the case asks for.
    pub fn reaches(&self, case: &Case) -> bool {
        let scaled = match (case.reach_percent, self.scale_percent) {
            (Some(reach), Some(found)) => found <= reach,
            (Some(_), None) => false,
            (None, _) => true,
        };
        self.error <= case.reach && scaled
    }
}

/// The numbers of the last of equal merges, with their median time.
fn middle(all: Vec<Numbers>) -> Numbers {
    let seconds = all.iter().filter_map(|numbers| numbers.seconds).collect();
    let last = all[all.len() - 1];
    Numbers { seconds: measuring::median(seconds), ..last }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(error: f64, scale_percent: Option<f64>) -> Numbers {
        Numbers { error, scale_percent, seconds: None, features_ms: None, memory: None }
    }

    #[test]
    fn a_case_is_reached_by_error_and_scale() {
        assert!(numbers(0.09, Some(0.2)).reaches(&CASES[0]));
        assert!(!numbers(0.11, Some(0.2)).reaches(&CASES[0]));
        assert!(!numbers(0.09, Some(0.4)).reaches(&CASES[0]));
        assert!(!numbers(0.09, None).reaches(&CASES[0]));
        assert!(!numbers(f64::NAN, Some(0.2)).reaches(&CASES[0]));
        assert!(numbers(0.19, None).reaches(&CASES[6]));
    }

    #[test]
    fn cases_need_their_sequences() {
        let have = ["parking_a", "parking_b"].map(str::to_owned);
        let possible: Vec<&str> = CASES.iter().filter(|c| c.is_possible(&have)).map(|c| c.name).collect();
        assert_eq!(possible, ["same", "same-once", "same-once-late"]);
    }

    #[test]
    fn times_are_medians() {
        let timed = |seconds| Numbers { seconds: Some(seconds), ..numbers(0.1, None) };
        assert_eq!(middle(vec![timed(3.0), timed(1.0), timed(2.0)]).seconds, Some(2.0));
        assert_eq!(middle(vec![numbers(0.1, None)]).seconds, None);
    }
}
