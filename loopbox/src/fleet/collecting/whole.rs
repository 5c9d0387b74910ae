//! Maps of cameras of which all is fetched: merged as far as it is here, and the common map written.

use super::Failed;
use super::merger::{Looking, Merger, met};
use super::timetable::Timetable;
use crate::fleet::agents::{Inputs, Maps};
use crate::fleet::company::Company;
use crate::fleet::findings::found;
use crate::fleet::listening::CommonListener;
use crate::fleet::remembering::Content;
use crate::fleet::sketching::Sketches;
use crate::merging::{Input, MergeRecord, Merging, Names, Share, write_results};
use crate::results::Results;
use anyhow::Result;
use fleet::findings::Found;
use map::{Identity, SensorKind};
use sources::Stop;
use std::time::Instant;

/// What is known by whole maps.
pub(super) struct Whole {
    /// The maps, those of LiDARs too.
    pub maps: Maps,
    results: Results,
    /// What was found by cameras' maps.
    pub found: Found,
    /// Merges that the joint pose graph took back, and why.
    undone: Vec<([Identity; 2], String)>,
    /// The maps of which the common map was made last.
    made_of: Vec<Content>,
    /// Whether pairs are left to be looked at, and whether some of them may give an agent its place.
    pub is_left: bool,
    pub may_join: bool,
    /// Something came that is not merged yet, or merged and not written.
    pub is_new: bool,
    pub to_write: bool,
}

/// How whole maps are merged this time.
pub(super) struct Round<'a> {
    /// How much is looked at; all of it where nothing is said.
    pub share: Option<Share>,
    /// Whether all that is here of the maps is taken in.
    pub is_taken: bool,
    /// Whether something is more urgent than agents that have their places.
    pub is_awaited: &'a (dyn Fn() -> bool + Sync),
    /// Who hangs together by all that was found.
    pub company: &'a Company,
    pub stop: &'a Stop,
}

impl Whole {
    /// Of nobody yet; what comes of them is written as these results.
    pub fn new(results: Results) -> Self {
        let (maps, found, undone, made_of) = Default::default();
        let (is_left, may_join, is_new, to_write) = Default::default();
        Self { maps, results, found, undone, made_of, is_left, may_join, is_new, to_write }
    }

    /// Something came.
    pub fn came(&mut self) {
        (self.is_new, self.to_write) = (true, true);
    }

    /// Whether all is merged and written.
    pub fn is_done(&self) -> bool {
        !self.is_new && !self.is_left && !self.to_write
    }

    /// Has what is not written merged again.
    pub fn urge(&mut self) {
        self.is_new = self.to_write;
    }

    /// Merges what is new or left; whether anything is to be told.
    ///
    /// # Errors
    /// When the maps cannot be merged or the results not be written.
    pub fn merge(
        &mut self,
        merger: &Merger,
        round: &Round,
        table: &mut Timetable,
        sketches: &mut Sketches,
        listeners: &mut [Box<dyn CommonListener>],
    ) -> Result<bool, Failed> {
        (self.is_new, self.is_left) = (false, false);
        let maps = self.maps.of_cameras();
        let Inputs { inputs, contents, whole } = &maps;
        if inputs.is_empty() {
            self.to_write = false;
            return Ok(true);
        }
        let exactly = round.is_taken && self.maps.at_rest(SensorKind::Camera);
        let places = self.maps.memory.take_places(contents);
        let (share, is_awaited) = (round.share, round.is_awaited);
        let looking = Looking { wanted: None, places, share, exactly, is_awaited };
        let looked = merger.look(&maps, &self.maps.memory, round.company, looking, round.stop);
        let mut looked = looked.map_err(Failed::Merge)?;
        self.maps.memory.keep(contents, looked.now());
        self.maps.memory.keep_places(contents, std::mem::take(&mut looked.places));
        (self.is_left, self.may_join) = (!looked.left.is_empty(), looked.may_join);
        let at_rest = exactly && !self.is_left;
        let begun = Instant::now();
        let is_same = self.made_of == *contents;
        if self.is_left && !looked.is_news && is_same && !table.may_tell(begun) {
            return Ok(false);
        }
        // Whoever waits for a place is not kept waiting by what is written, unless that would be for ever.
        let is_patient = self.is_left && (self.may_join || is_awaited());
        let is_due = table.may_write(self.is_left, is_patient, begun);
        let is_settled = is_patient || !table.may_settle(begun);
        let optimise = at_rest || is_due || !(self.is_left && is_settled);
        let undone = if optimise { Vec::new() } else { self.undone_of(contents) };
        let merging = merger.made(&maps, looked.encounters, optimise, &undone).map_err(Failed::Merge)?;
        table.told(Instant::now());
        self.made_of.clone_from(contents);
        self.found = found(inputs, &merging, whole);
        sketches.met(&met(&merging, contents));
        if !optimise {
            return Ok(true);
        }
        table.settled(begun, Instant::now());
        self.undone = undone_by(&merging, contents);
        listeners.iter_mut().for_each(|listener| listener.cameras(&merging.fused));
        if merging.anything_met() && (at_rest || is_due) {
            self.write(inputs, &merging, merger).map_err(Failed::Write)?;
            table.written(Instant::now());
            self.to_write = self.is_left;
        }
        if !merging.anything_met() && !self.is_left {
            self.to_write = false;
        }
        Ok(true)
    }

    fn write(&mut self, inputs: &[Input], merging: &Merging, merger: &Merger) -> Result<()> {
        let names = Names::new(&merging.common);
        let mut record = MergeRecord::new(inputs, merging, &merger.params, &names)?;
        write_results(&mut self.results, inputs, merging, &names, &mut record)?;
        self.results.commit()
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

/// The merges that were taken back, by whose maps they were of, and why.
fn undone_by(merging: &Merging, contents: &[Content]) -> Vec<([Identity; 2], String)> {
    let joined = merging.encounters.iter().filter(|encounter| encounter.joined.is_some());
    let undone = joined.filter_map(|encounter| {
        let why = merging.undone(encounter)?.to_owned();
        Some((encounter.as_given().map(|map| contents[map].agent), why))
    });
    undone.collect()
}
