//! What was found out about where agents are, as it is told to all of them, as JSON.

mod folded;

use folded::Folded;
use geometry::{Se3, Sim3};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Where an agent is in its own world, `tx ty tz qx qy qz qw scale`.
const ALONE: [f64; 8] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0];

/// What is said of a pair that is merged.
pub const ACCEPTED: &str = "accepted";
/// What is said of a pair that is not merged while more of its maps comes or is looked at.
pub const NOT_YET: &str = "not yet";

/// Where agents are, and who met whom.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MergeResults {
    /// Every agent whose map could be looked at.
    pub agents: Vec<PlacedAgent>,
    /// Every two of them.
    #[serde(rename = "meetings")]
    pub pair_verdicts: Vec<PairVerdict>,
}

/// An agent.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlacedAgent {
    /// Its identity, `UUID/EPOCH`.
    pub agent: String,
    /// What people call it.
    pub name: String,
    /// Keyframes of its map that were looked at.
    pub keyframes: usize,
    /// Whether that was all of its map.
    pub whole: bool,
    /// The eldest of the agents it hangs together with: the common frame is its world.
    pub root: String,
    /// Maps points of the agent's world to the common frame, `tx ty tz qx qy qz qw scale`.
    pub root_from_agent: [f64; 8],
}

/// Two agents.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairVerdict {
    /// Their names.
    pub names: [String; 2],
    /// Their identities, `UUID/EPOCH`.
    #[serde(default)]
    pub agents: [String; 2],
    /// [`ACCEPTED`], [`NOT_YET`], `undecided` or `refused`.
    pub verdict: String,
    /// Why not, where they were not merged.
    pub why: Option<String>,
    /// Whether parts of their maps are being looked at, before anything is said of more.
    #[serde(default)]
    pub pending: bool,
}

impl MergeResults {
    /// What `other` found, and this of what that says nothing of. Agents that only this joins stand in one frame
    /// afterwards, that of the most of them.
    pub fn overlaid_by(self, other: &Self) -> Self {
        let mut all = other.clone();
        for new in &self.agents {
            if all.place(&new.agent).is_none() {
                all.agents.push(PlacedAgent {
                    root: new.agent.clone(),
                    root_from_agent: ALONE,
                    ..new.clone()
                });
            }
        }
        let roots: BTreeSet<&String> = self.agents.iter().map(|agent| &agent.root).collect();
        for root in roots {
            all.join(self.agents.iter().filter(|agent| agent.root == *root).collect());
        }
        let is_known = |new: &PairVerdict| {
            let of_both = |old: &PairVerdict| new.agents.iter().all(|agent| old.agents.contains(agent));
            other.pair_verdicts.iter().any(of_both)
        };
        all.pair_verdicts.extend(self.pair_verdicts.into_iter().filter(|new| !is_known(new)));
        all
    }

    /// As it is told where no more than so many bytes can be: without what comes last, pairs before agents.
    pub fn to_bytes_within(mut self, limit: usize) -> Vec<u8> {
        loop {
            let bytes = self.to_bytes();
            if bytes.len() <= limit {
                return bytes;
            }
            match self.pair_verdicts.len() {
                0 => self.agents.truncate(self.agents.len() * 3 / 4),
                count => self.pair_verdicts.truncate(count * 3 / 4),
            }
        }
    }

    /// This, and what was found of other agents.
    pub fn and(mut self, other: Self) -> Self {
        self.agents.extend(other.agents);
        self.pair_verdicts.extend(other.pair_verdicts);
        self
    }

    /// Brings agents that hang together, placed in a frame of their own, into one frame here: that in which the most
    /// already are, of equals the one that is theirs as well, together with all who hang together with one of them.
    fn join(&mut self, together: Vec<&PlacedAgent>) {
        let size = |root: &String| self.agents.iter().filter(|agent| agent.root == *root).count();
        let rank = |new: &&&PlacedAgent| {
            let size = self.place(&new.agent).map_or(0, |(root, _)| size(root));
            (size, new.agent == new.root)
        };
        let Some(anchor) = together.iter().max_by_key(rank) else { return };
        let Some((root, root_from_anchor)) = self.place(&anchor.agent) else { return };
        let root = root.clone();
        let root_from_new = root_from_anchor * transform(&anchor.root_from_agent).inverse();
        for new in together {
            let Some((old_root, old_from_agent)) = self.place(&new.agent) else { continue };
            let old_root = old_root.clone();
            if old_root == root {
                continue;
            }
            let root_from_old = root_from_new * transform(&new.root_from_agent) * old_from_agent.inverse();
            for agent in self.agents.iter_mut().filter(|agent| agent.root == old_root) {
                agent.root.clone_from(&root);
                agent.root_from_agent = numbers(&(root_from_old * transform(&agent.root_from_agent)));
            }
        }
    }

    /// The root of an agent, and root_from_agent.
    fn place(&self, agent: &str) -> Option<(&String, Sim3)> {
        let found = self.agents.iter().find(|found| found.agent == agent)?;
        Some((&found.root, transform(&found.root_from_agent)))
    }

    /// Whether an agent hangs together with another one.
    pub fn is_joined(&self, agent: &str) -> bool {
        let root = self.agents.iter().find(|about| about.agent == agent).map(|about| &about.root);
        root.is_some_and(|root| self.agents.iter().any(|other| other.root == *root && other.agent != agent))
    }

    /// Says of pairs that no more is known of them than that more is looked at.
    pub fn postpone(&mut self, is_pending: impl Fn(&[String; 2]) -> bool) {
        for pair in self.pair_verdicts.iter_mut().filter(|pair| is_pending(&pair.agents)) {
            (pair.pending, pair.verdict) = (true, NOT_YET.into());
            pair.why = Some("more of both maps is being looked at".into());
        }
    }

    /// Whether something was decided about two agents.
    pub fn has_decided(&self, agents: &[String; 2]) -> bool {
        let of_both = |pair: &&PairVerdict| agents.iter().all(|agent| pair.agents.contains(agent));
        self.pair_verdicts.iter().filter(of_both).any(|pair| !pair.pending)
    }

    /// As it is told.
    pub fn to_bytes(&self) -> Vec<u8> {
        // Numbers and texts can always be written.
        serde_json::to_vec(&Folded::of(self)).unwrap_or_default()
    }

    /// What others told.
    ///
    /// # Errors
    /// When it is not to be understood, or places an agent where none can be.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let folded: Folded = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
        let results = folded.unfolded()?;
        match results.agents.iter().find(|agent| !is_place(&agent.root_from_agent)) {
            Some(agent) => Err(format!("the place of {:?} is none: {:?}", agent.name, agent.root_from_agent)),
            None => Ok(results),
        }
    }

    /// How many pairs were merged.
    pub fn accepted(&self) -> usize {
        self.pair_verdicts.iter().filter(|pair| pair.verdict == ACCEPTED).count()
    }
}

/// What was found, to be told to many, each what concerns it.
pub struct ByAgent {
    found: Arc<MergeResults>,
    /// Of each agent the pairs of which it is one.
    pair_verdicts: BTreeMap<String, Vec<usize>>,
}

impl ByAgent {
    /// Of all that was found.
    pub fn new(found: Arc<MergeResults>) -> Self {
        let mut pair_verdicts = BTreeMap::<String, Vec<usize>>::new();
        for (number, pair) in found.pair_verdicts.iter().enumerate() {
            pair.agents.iter().for_each(|agent| pair_verdicts.entry(agent.clone()).or_default().push(number));
        }
        Self { found, pair_verdicts }
    }

    /// What concerns some agents: where they are, and then who stands in one frame with them, before all others; and the
    /// pairs of which they are one, what was accepted before what was not. Of nobody in particular it is all.
    pub fn about(&self, agents: &BTreeSet<String>) -> MergeResults {
        let is_one = |agent: &PlacedAgent| agents.contains(&agent.agent);
        let mut all = self.found.agents.clone();
        let roots: BTreeSet<String> = all.iter().filter(|a| is_one(a)).map(|a| a.root.clone()).collect();
        all.sort_by_key(|agent| (!is_one(agent), !roots.contains(&agent.root)));
        let numbers: BTreeSet<usize> = match agents.is_empty() {
            true => (0..self.found.pair_verdicts.len()).collect(),
            false => {
                agents.iter().filter_map(|agent| self.pair_verdicts.get(agent)).flatten().copied().collect()
            }
        };
        let mut pair_verdicts: Vec<PairVerdict> =
            numbers.into_iter().map(|number| self.found.pair_verdicts[number].clone()).collect();
        pair_verdicts.sort_by_key(|pair| pair.verdict != ACCEPTED);
        MergeResults { agents: all, pair_verdicts }
    }
}

/// `tx ty tz qx qy qz qw scale` of a transform.
pub fn numbers(transform: &Sim3) -> [f64; 8] {
    let [tx, ty, tz, qx, qy, qz, qw] = transform.rigid().to_tum();
    [tx, ty, tz, qx, qy, qz, qw, transform.scale]
}

/// Whether `tx ty tz qx qy qz qw scale` is a transform: finite numbers, a unit quaternion, a scale above 0.
fn is_place(numbers: &[f64; 8]) -> bool {
    let norm = numbers[3..7].iter().map(|q| q * q).sum::<f64>();
    (norm - 1.0).abs() < 1e-6 && transform(numbers).is_valid()
}

/// The transform of `tx ty tz qx qy qz qw scale`.
fn transform(numbers: &[f64; 8]) -> Sim3 {
    let [tx, ty, tz, qx, qy, qz, qw, scale] = *numbers;
    let rigid = Se3::from_tum([tx, ty, tz, qx, qy, qz, qw]);
    Sim3::new(rigid.rotation, rigid.translation, scale)
}

#[cfg(test)]
mod tests;
