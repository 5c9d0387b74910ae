//! `report.html` of a merging: the common map in 3-D, what joined the agents, and what was refused.
//!
//! One page without a network, as that of a run ([`view::report`]), of which it takes the 3-D view, the plots and
//! the styles. It shows the group of agents that the first map is in; the other groups are named.

mod agents;
mod matches;
mod pair_results;
mod paths;
mod place;
#[cfg(test)]
mod tests;

use super::{Input, Merging};
use agents::{Graph, Group};
use anyhow::Context;
use matches::Pictures;
use pair_results::PairReport;
use paths::Paths;
use place::Places;
use serde::ser::{Error, Serialize, SerializeSeq, Serializer};
use std::cell::RefCell;
use std::io::Write;
use std::path::Path;
use view::report::cloud::Cloud;
use view::report::page::{self, Template};
use view::report::scene::{PlacedFrame, Scene, placed_frames, placed_keyframes};
use view::script;

/// Most points of the cloud; ten bytes each, before base64.
const MAX_POINTS: usize = 400_000;
/// Most frames of all trajectories together; some fifty bytes each, before base64.
const MAX_FRAMES: usize = 30_000;

/// The page of a merging.
const TEMPLATE: Template = Template {
    body: include_str!("assets/body.html"),
    style: include_str!("assets/merge.css"),
    policy: "",
    scene: true,
    scripts: &[
        script!("assets/matches.js"),
        script!("assets/tables.js"),
        script!("assets/paths.js"),
        script!("assets/start.js"),
    ],
};

/// Writes the report of a merging to `path`, replacing what was there. `inputs` are those that were merged, in their
/// order.
///
/// # Errors
/// When nothing was merged at all, a key image cannot be encoded or the file cannot be written.
pub fn write(path: &Path, inputs: &[Input], merging: &Merging) -> anyhow::Result<()> {
    page::write(path, |page| render(inputs, merging, page))
}

/// Writes the whole page to `page`.
fn render(inputs: &[Input], merging: &Merging, page: &mut dyn Write) -> anyhow::Result<()> {
    let names: Vec<&str> = inputs.iter().map(|input| &*input.name).collect();
    let pictures = RefCell::default();
    TEMPLATE.write(&names.join(" + "), &Data::new(inputs, merging, &pictures)?, page)
}

/// The page's data, as its scripts read it.
#[derive(serde::Serialize)]
struct Data<'a> {
    /// The inputs' names.
    inputs: Vec<String>,
    scene: Scene,
    cloud: Cloud,
    paths: Paths,
    graph: Graph,
    /// The groups of agents that are not shown.
    others: Vec<Group>,
    #[serde(rename = "meetings")]
    pair_reports: PairReports<'a>,
    /// Those of the pairs, which stand before them.
    pictures: &'a RefCell<Pictures>,
    /// Seconds that making the common map took.
    fusion_seconds: f64,
}

/// Every two of the maps, each made when it is written: of many there is no room for all.
struct PairReports<'a> {
    inputs: &'a [Input],
    merging: &'a Merging,
    places: Places<'a>,
    pictures: &'a RefCell<Pictures>,
}

impl Serialize for PairReports<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(self.merging.pair_results.len()))?;
        for pair_result in self.merging.pair_results.iter() {
            let mut pictures = self.pictures.borrow_mut();
            let report = PairReport::new(self.inputs, &pair_result, &self.places, &mut pictures);
            pair_result.as_given().iter().for_each(|&input| self.inputs[input].features.rest());
            list.serialize_element(&report.map_err(S::Error::custom)?)?;
        }
        list.end()
    }
}

impl<'a> Data<'a> {
    fn new(
        inputs: &'a [Input],
        merging: &'a Merging,
        pictures: &'a RefCell<Pictures>,
    ) -> anyhow::Result<Self> {
        let (displayed, others) = merging.fused.split_first().context("there is no map to report on")?;
        let map = &displayed.map;
        let keyframes = placed_keyframes(map);
        let mut frames: Vec<PlacedFrame> = placed_frames(map);
        view::report::cloud::evenly(&mut frames, MAX_FRAMES);
        let places = Places::new(merging, displayed, &keyframes);
        Ok(Self {
            inputs: inputs.iter().map(|input| input.name.clone()).collect(),
            scene: Scene::new(map, &keyframes, &frames),
            cloud: Cloud::new(map, &keyframes, MAX_POINTS),
            paths: Paths::new(&frames),
            graph: Graph::new(merging, displayed),
            others: others.iter().map(Group::new).collect(),
            pair_reports: PairReports { inputs, merging, places, pictures },
            pictures,
            fusion_seconds: merging.fusion_seconds,
        })
    }
}
