//! The maps of the agents, as runs that reached nobody leave them.

use super::super::{LOOK, Plan, wait};
use super::{AGENTS, KEYFRAMES};
use crate::crowd::maps;
use crate::measure::make_empty;
use crate::merging::Program;
use ::fleet::node::Quota;
use ::fleet::publishing::Publisher;
use ::fleet::service::{Service, ServiceOptions};
use ::fleet::wire::Role;
use anyhow::{Context, Result};
use map::{AgentId, Map};
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A map that is kept to be told.
pub(super) struct PublishedMap {
    /// Its agent's identity, `UUID/EPOCH`.
    pub agent: String,
    /// The folder with its objects.
    pub home: PathBuf,
}

/// The maps of all agents; made if they are not there.
pub(super) fn maps(plan: &Plan) -> Result<Vec<PublishedMap>> {
    let program = Program { loopbox: plan.loopbox.to_owned() };
    let crowd = plan.work.join(format!("crowd-{AGENTS}x{KEYFRAMES}"));
    (0..AGENTS)
        .map(|number| {
            let file = maps::file(number, AGENTS + 1, KEYFRAMES, &program, &crowd)?;
            let (map, name) = (map::load_map(&file)?.map, maps::name_of(number));
            let about = map.agents.get(&AgentId::default()).context("a map without an agent")?;
            let identity = about.identity.context("an agent without an identity")?;
            let home = plan.work.join("fleet").join("told").join(&name);
            if !home.join("fleet.json").is_file() {
                make_empty(&home)?;
                keep(&map, Publisher::new(identity, number as u64), &name, &home)?;
            }
            Ok(PublishedMap { agent: identity.to_string(), home })
        })
        .collect()
}

/// Takes a map apart as it is told, and keeps it for who is to tell it.
fn keep(map: &Map, mut publisher: Publisher, name: &str, home: &Path) -> Result<()> {
    let publication = publisher.publish(map, true)?.context("nothing is to be told of a map")?;
    let service = Service::start(
        ServiceOptions {
            folder: home.join("fleet"),
            name: name.to_owned(),
            role: Role::Agent,
            listen: None,
            dial: Vec::new(),
            quota: Quota::default(),
            waits: true,
            keys: None,
        },
        |_| {},
    )?;
    service.publish(publication);
    let begun = Instant::now();
    while service.own().is_empty() {
        wait(begun, LOOK, "a map is not kept")?;
    }
    drop(service);
    let found = json!({ "agents": [], "meetings": [] });
    let output =
        json!({ "name": name, "links": [], "agents": [], "found": found, "told": [], "trouble": [] });
    fs::write(home.join("fleet.json"), output.to_string()).context("fleet.json cannot be written")
}
