//! Maps of cameras of which all is fetched: merged as far as it is here, and settled beside that.

use super::merger::{Looking, Merger, met};
use super::planning::Planner;
use super::settling::{Job, Outcome, settle};
use super::step::Step;
use super::timetable::Timetable;
use super::worker::Worker;
use super::{Failed, SHARE};
use crate::fleet::agents::{Inputs, Maps};
use crate::fleet::company::Company;
use crate::fleet::findings::found;
use crate::fleet::listening::CommonListener;
use crate::fleet::remembering::Content;
use crate::merging::Input;
use crate::results::Results;
use anyhow::Result;
use fleet::findings::Found;
use map::{Identity, SensorKind};
use std::collections::BTreeSet;
use std::time::Instant;

/// What is known by whole maps.
pub(super) struct Whole {
    /// The maps, those of LiDARs too.
    pub maps: Maps,
    /// What was found by cameras' maps.
    pub found: Found,
    /// Merges that the joint pose graph took back, and why.
    undone: Vec<([Identity; 2], String)>,
    /// The maps of which the agents' places were told last.
    told_of: Vec<Content>,
    /// Whether pairs are left to be looked at, and whether some of them may give an agent its place.
    pub is_left: bool,
    pub may_join: bool,
    /// Something came, or is to be seen anew, that is not merged yet.
    pub is_new: bool,
    settler: Worker<Outcome>,
    /// Where the common map is written; away while it is settled.
    results: Option<Results>,
    states: States,
}

/// States of the merging by number: each differs from the one before by a map or by what a pair made of each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct States {
    /// As it is now.
    now: u64,
    /// That of which the joint pose graph was made last, or was tried.
    settled: u64,
    /// That which was written last.
    written: u64,
}

/// How whole maps are merged this time.
pub(super) struct Round<'a> {
    pub settling: Settling,
    /// Whether all that is here of the maps is taken in.
    pub is_taken: bool,
    /// Whether something is more urgent than agents that have their places, whatever comes.
    pub is_awaited: bool,
    /// Who hangs together by all that was found.
    pub company: &'a Company,
    pub step: &'a Step<'a>,
}

/// Where what the pairs made of each other is settled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Settling {
    /// In a thread beside, when it is due.
    Beside,
    /// In the thread that calls, now.
    Now,
    /// Later.
    Later,
}

impl Whole {
    /// Of nobody yet; what comes of them is written as these results.
    ///
    /// # Errors
    /// When a thread cannot be started.
    pub fn new(results: Results, beside: bool) -> Result<Self> {
        let (maps, found, undone, told_of, states) = Default::default();
        let (is_left, may_join, is_new) = Default::default();
        let (settler, results) = (Worker::new(beside)?, Some(results));
        Ok(Self { maps, found, undone, told_of, is_left, may_join, is_new, settler, results, states })
    }

    /// Something came.
    pub fn came(&mut self) {
        self.is_new = true;
        self.states.now += 1;
    }

    /// Whether all is merged and written.
    pub fn is_done(&self) -> bool {
        let is_settled = self.states.settled == self.states.now && self.settler.is_idle();
        !self.is_new && !self.is_left && is_settled && self.states.written == self.states.now
    }

    /// Has what is not written merged again.
    pub fn urge(&mut self) {
        self.is_new = self.states.written != self.states.now;
    }

    /// Has all merged again where the joint pose graph of it is due.
    pub fn look_after(&mut self, table: &Timetable, now: Instant) {
        let at_rest = !self.is_left && self.maps.at_rest(SensorKind::Camera);
        let is_due =
            self.states.settled != self.states.now && (at_rest || table.may_settle(self.is_left, now));
        self.is_new |= is_due && self.settler.is_idle();
    }

    /// Merges what is new or left; whether anything is to be told.
    ///
    /// # Errors
    /// When the maps cannot be merged, or the results not be written where that is done in this thread.
    pub fn merge(
        &mut self,
        merger: &Merger,
        round: &Round,
        table: &mut Timetable,
        planner: &mut Planner,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        (self.is_new, self.is_left) = (false, false);
        let maps = self.maps.of_cameras();
        let contents = &maps.contents;
        if maps.inputs.is_empty() {
            (self.states.settled, self.states.written) = (self.states.now, self.states.now);
            return Ok(true);
        }
        let exactly = round.is_taken && self.maps.at_rest(SensorKind::Camera);
        let places = self.maps.memory.take_places(contents);
        let Round { step, company, .. } = *round;
        let look = |comes: &(dyn Fn() -> bool + Sync)| {
            let is_awaited = || round.is_awaited || comes();
            let looking = Looking { wanted: None, places, share: SHARE, exactly, is_awaited: &is_awaited };
            merger.look(&maps, &self.maps.memory, company, looking, step.stop)
        };
        let looked = match round.settling {
            Settling::Beside => planner.meanwhile(step, company, merger, &BTreeSet::new(), look),
            Settling::Now | Settling::Later => look(&|| false),
        };
        let mut looked = looked.map_err(|error| self.not_merged(error))?;
        self.maps.memory.keep(contents, looked.now());
        self.maps.memory.keep_places(contents, std::mem::take(&mut looked.places));
        let is_changed = looked.now().next().is_some() || self.told_of != *contents;
        self.states.now += u64::from(is_changed);
        (self.is_left, self.may_join) = (!looked.left.is_empty(), looked.may_join);
        let at_rest = exactly && !self.is_left;
        let now = Instant::now();
        let is_due = at_rest || round.settling == Settling::Now;
        let writes = self.states.written != self.states.now && (is_due || table.may_write(self.is_left, now));
        let settles =
            self.states.settled != self.states.now && (is_due || table.may_settle(self.is_left, now));
        let settles = (settles || writes) && self.settler.is_idle() && round.settling != Settling::Later;
        let is_told = !looked.is_news && self.told_of == *contents && !table.may_tell(now);
        if self.is_left && is_told && !settles {
            return Ok(false);
        }
        let undone = self.undone_of(contents);
        let merging = merger.placed(&maps, looked.encounters, &undone);
        let merging = merging.map_err(|error| self.not_merged(error))?;
        table.told(Instant::now());
        self.told_of.clone_from(contents);
        let open = self.open(&maps);
        self.found = found(&maps.inputs, &merging, &maps.whole, |pair| open.contains(&pair));
        planner.sketches.met(&met(&merging, contents));
        let Some(results) = self.results.take_if(|_| settles) else { return Ok(true) };
        let (revision, params) = (self.states.now, merger.params.clone());
        let job = Job { revision, maps, open, encounters: merging.encounters, params, results, writes };
        if round.settling == Settling::Beside {
            self.settler.start(move || settle(job)).map_err(Failed::Write)?;
        } else {
            let outcome = merger.on_pool(|| settle(job));
            self.adopt(outcome, table, listeners)?;
        }
        Ok(true)
    }

    /// The maps cannot be merged, which is not tried again before something changes.
    fn not_merged(&mut self, error: anyhow::Error) -> Failed {
        self.states.settled = self.states.now;
        Failed::Merge(error)
    }

    /// Takes what was settled, once that is done, or waits for it where that is asked for; whether anything is to be told.
    ///
    /// # Errors
    /// When the maps cannot be merged or the results not be written.
    pub fn take_settled(
        &mut self,
        waits: bool,
        table: &mut Timetable,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        let outcome = if waits { self.settler.wait() } else { self.settler.done() };
        match outcome.map_err(Failed::Write)? {
            Some(outcome) => self.adopt(outcome, table, listeners),
            None => Ok(false),
        }
    }

    /// Takes what was settled: all of it if nothing changed since; else what the joint pose graph took back, and it is told
    /// anew where the agents are without that.
    fn adopt(
        &mut self,
        outcome: Outcome,
        table: &mut Timetable,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        let now = Instant::now();
        self.results = Some(outcome.results);
        table.settled(outcome.took, now);
        self.states.settled = outcome.revision;
        let settled = outcome.settled.map_err(Failed::Merge)?;
        let is_current = outcome.revision == self.states.now;
        if is_current {
            self.found = settled.found;
        } else {
            self.is_new |= self.undone != settled.undone;
        }
        self.undone = settled.undone;
        listeners.iter_mut().for_each(|listener| listener.cameras(&settled.fused));
        match settled.written {
            Some(Err(error)) => return Err(Failed::Write(error)),
            Some(Ok(())) => table.written(now),
            None => {}
        }
        if settled.written.is_some() || !settled.has_met {
            self.states.written = outcome.revision;
        }
        Ok(is_current)
    }

    /// The pairs of these maps of which more is to be looked at: a map still grows, or what was looked at is not all that is to
    /// last.
    fn open(&self, maps: &Inputs<Input>) -> BTreeSet<[usize; 2]> {
        let count = maps.inputs.len();
        let pairs = (1..count).flat_map(|b| (0..b).map(move |a| [a, b]));
        let is_settled = |pair: [usize; 2]| {
            let is_over = pair.iter().all(|map| maps.over[*map]);
            let known = self.maps.memory.recall(&maps.contents, pair, true);
            is_over && known.is_some_and(|known| !known.is_due)
        };
        pairs.filter(|pair| !is_settled(*pair)).flat_map(|[a, b]| [[a, b], [b, a]]).collect()
    }

    /// The merges that the joint pose graph took back, by the numbers of these maps.
    fn undone_of(&self, contents: &[Content]) -> Vec<([usize; 2], String)> {
        let number = |agent: Identity| contents.iter().position(|content| content.agent == agent);
        let numbered = |([a, b], why): &([Identity; 2], String)| {
            let (a, b) = (number(*a)?, number(*b)?);
            Some(([a.min(b), a.max(b)], why.clone()))
        };
        self.undone.iter().filter_map(numbered).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::settling::Settled;
    use super::*;
    use crate::results::Owner;
    use fleet::findings::FoundAgent;
    use map::Uuid;
    use std::io::{Error, ErrorKind};
    use std::path::Path;
    use std::time::Duration;

    fn agent(number: u128) -> Identity {
        Identity { uuid: Uuid::from_u128(number), epoch: 0 }
    }

    fn found(number: u128) -> Found {
        let (agent, root) = (agent(number).to_string(), agent(number).to_string());
        let (name, root_from_agent) = (String::new(), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
        let agents = vec![FoundAgent { agent, name, keyframes: 9, whole: true, root, root_from_agent }];
        Found { agents, meetings: Vec::new() }
    }

    /// One at work on state 3, and what comes of it.
    fn at_work(out: &Path, written: Option<Result<()>>) -> (Whole, Outcome) {
        let results = Results::create(out, &Owner::Merge, false).unwrap();
        let mut whole = Whole::new(results, false).unwrap();
        (0..3).for_each(|_| whole.came());
        whole.is_new = false;
        let (found, undone) = (found(3), vec![([agent(1), agent(2)], "why".to_owned())]);
        let settled = Ok(Settled { fused: Vec::new(), found, undone, has_met: true, written });
        let results = whole.results.take().unwrap();
        (whole, Outcome { revision: 3, results, took: Duration::from_secs(2), settled })
    }

    #[test]
    fn what_is_settled_of_what_is_there_is_taken_as_it_is() {
        let room = tempfile::tempdir().unwrap();
        let (mut whole, outcome) = at_work(room.path(), Some(Ok(())));
        let mut table = Timetable::new(Instant::now());
        assert!(!whole.is_done());
        assert!(whole.adopt(outcome, &mut table, &mut []).is_ok_and(|is_news| is_news));
        assert!(whole.found == found(3) && whole.is_done() && whole.results.is_some());
        assert!(!table.may_settle(true, Instant::now()));
    }

    #[test]
    fn of_what_changed_meanwhile_it_is_known_what_was_taken_back_and_the_rest_is_done_again() {
        let room = tempfile::tempdir().unwrap();
        let (mut whole, outcome) = at_work(room.path(), Some(Ok(())));
        let start = Instant::now();
        let mut table = Timetable::new(start);
        whole.came();
        whole.is_new = false;
        assert!(whole.adopt(outcome, &mut table, &mut []).is_ok_and(|is_news| !is_news));
        assert!(whole.found == Found::default() && whole.undone.len() == 1);
        // Where agents are without what was taken back is to be said.
        assert!(std::mem::take(&mut whole.is_new) && !whole.is_done());
        whole.is_left = true;
        whole.look_after(&table, start + Duration::from_secs(9));
        assert!(!whole.is_new);
        whole.look_after(&table, start + Duration::from_secs(30));
        assert!(whole.is_new);
    }

    #[test]
    fn what_was_not_written_is_written_again_and_what_failed_is_not_tried_for_ever() {
        let room = tempfile::tempdir().unwrap();
        let full = Error::from(ErrorKind::StorageFull);
        let (mut whole, outcome) = at_work(room.path(), Some(Err(full.into())));
        let mut table = Timetable::new(Instant::now());
        let Err(Failed::Write(_)) = whole.adopt(outcome, &mut table, &mut []) else { panic!("it is told") };
        assert!(!whole.is_done() && !whole.is_new);
        whole.urge();
        assert!(whole.is_new);
        drop(whole);
        let (mut whole, outcome) = at_work(room.path(), None);
        let outcome = Outcome { settled: Err(anyhow::anyhow!("no map")), ..outcome };
        let Err(Failed::Merge(_)) = whole.adopt(outcome, &mut table, &mut []) else { panic!("it is told") };
        whole.look_after(&table, Instant::now() + Duration::from_secs(99));
        assert!(!whole.is_new && !whole.is_done());
    }
}
