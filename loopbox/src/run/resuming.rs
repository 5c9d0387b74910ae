//! Going on in a map that an earlier run left: which map, whether it fits, and what is said of it.

use crate::open::{OpenedMap, open_map};
use anyhow::{Context, Result, bail};
use geometry::{Pinhole, Swap};
use map::{AgentInfo, Identity, Map, MapError, PlaceIndex};
use merge::common_map::{CommonMap, Fused, FusionParams};
use place_recog::ThumbnailIndex;
use serde::Serialize;
use slam_direct::{Agent, Atlas, Joint, Params, ResumeMode};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Focal lengths and principal points that differ by less, pixels, are those of one camera: a thousandth of what the
/// most exact calibration tells.
const SAME: f64 = 1e-4;

/// The map that a run is to go on in.
#[derive(Clone, Debug)]
pub struct Resume {
    /// Its file, or the folder of results that holds it.
    pub map: PathBuf,
    /// Whether it is extended.
    pub mode: ResumeMode,
    /// What was read of it, where that was done before.
    pub opened: Option<Box<OpenedMap>>,
}

/// What `run.json` says of the map that the run went on in.
#[derive(Clone, Debug, Serialize)]
pub struct Resumed {
    /// Its file.
    pub map: String,
    /// Who made it, `UUID/EPOCH`; nobody alone a common map.
    pub identity: Option<String>,
    /// The names of its agents.
    pub agents: Vec<String>,
    /// Keyframes it had.
    pub keyframes: u64,
    /// Frames with a pose it had.
    pub frames: u64,
    /// Whether it was left as it was, and frames only got poses in it.
    pub localised_only: bool,
}

/// A map that fits the run.
pub struct Kept {
    file: PathBuf,
    map: Map,
    /// Whose map it is once this run has extended it; nobody's alone of a common map.
    about: Option<AgentInfo>,
    /// What is done with it.
    pub mode: ResumeMode,
    /// The index of the first frame that is new: frames are counted on. Who extends a common map counts from 0.
    pub first_index: u64,
}

impl Kept {
    /// Reads the map and makes sure that images of `camera` can be sought in it; `session` is who would map without it.
    /// Gives what there is to know of the file as well, for people.
    ///
    /// # Errors
    /// When there is no such map, or it is not of this camera alone.
    pub fn open(resume: Resume, camera: &Pinhole, session: &AgentInfo) -> Result<(Self, Vec<String>)> {
        let opened = resume.opened.map_or_else(|| open_map(&resume.map), |opened| Ok(*opened))?;
        let (file, map) = (opened.file, opened.map);
        map.of_cameras().with_context(|| {
            let hint = "hint: of a common map of both, `loopbox unmerge` gives each agent's own";
            format!("{}: is not a map of cameras\n{hint}", file.display())
        })?;
        refuse_other_cameras(&file, &map, camera, session)?;
        let is_extended = resume.mode == ResumeMode::Mapping && map.agents.len() > 1;
        let of_map = map.frames.iter().map(|frame| frame.frame_index + 1);
        let first_index = of_map.max().filter(|_| !is_extended).unwrap_or_default();
        let only = map.agents.values().next().filter(|_| map.agents.len() == 1);
        let about = only.map(|info| extended(info, session, map.keyframes.len(), first_index));
        Ok((Self { file, map, about, mode: resume.mode, first_index }, opened.warnings))
    }

    /// Makes sure that results in `folder` do not take the place of a map that is to stay as it is.
    ///
    /// # Errors
    /// When they would.
    pub fn spare(&self, folder: &Path) -> Result<()> {
        let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
        if self.mode == ResumeMode::Localising && whole(&self.file).starts_with(whole(folder)) {
            bail!(
                "{}: holds the map that is localised in, which is to stay as it is\nhint: give --out another folder",
                folder.display()
            );
        }
        Ok(())
    }

    /// Keeps its keyframes' images and depths where `swap` has room for them.
    pub fn swap_out(&mut self, swap: &dyn Swap) {
        self.map.swap_out(swap);
    }

    /// The run that goes on in it.
    ///
    /// # Errors
    /// When there is nothing to track against.
    pub fn atlas(&self, params: &Params) -> Result<Atlas> {
        let first = Agent::resume(self.map.clone(), places(), params.clone(), self.mode)
            .with_context(|| self.file.display().to_string())?;
        Ok(Atlas::resume(first, places, params.clone()))
    }

    /// What its agent is called once the map is extended; `None` of a common map.
    pub fn about(&self) -> Option<&AgentInfo> {
        self.about.as_ref()
    }

    /// Whether the map is a common one that the run extends, as one more of its agents.
    pub fn is_joined(&self) -> bool {
        self.mode == ResumeMode::Mapping && self.about.is_none()
    }

    /// Makes sure that who comes to a common map is not in it already.
    ///
    /// # Errors
    /// When it is.
    pub fn refuse_again(&self, identity: &Identity) -> Result<()> {
        let is_same = |info: &&AgentInfo| info.identity.is_some_and(|known| known.uuid == identity.uuid);
        match self.map.agents.values().find(is_same).filter(|_| self.is_joined()) {
            None => Ok(()),
            Some(info) => bail!(
                "{}: holds the map of this very recording, as that of {}\nhint: a common map is extended by other recordings; \
                 --localise tells poses in it",
                self.file.display(),
                info.name
            ),
        }
    }

    /// The map once the run of the agent `own` has joined it. It is made anew like that of a merge: what joined the others
    /// before counts as what joins the new one to them.
    ///
    /// # Errors
    /// When the two cannot be in one.
    pub fn joined(&self, joint: Joint, own: Map) -> Result<Map, MapError> {
        let about: Vec<AgentInfo> = own.agents.values().cloned().collect();
        let united = joint.united(own)?;
        let mut map = made_anew(&united).unwrap_or(united);
        let number = next_number(&map.merge_provenance, "joined", "agent");
        for info in about {
            let entries = [("agent", Some(&info.name)), ("program", info.provenance.get("program"))];
            let entries = entries.into_iter().filter_map(|(key, value)| Some((key, value?)));
            map.merge_provenance
                .extend(entries.map(|(key, value)| (format!("joined {number}: {key}"), value.clone())));
        }
        Ok(map)
    }

    /// For `run.json`.
    pub fn record(&self) -> Resumed {
        Resumed {
            map: self.file.display().to_string(),
            identity: self.about().and_then(|about| about.identity.as_ref()).map(Identity::to_string),
            agents: self.map.agents.values().map(|info| info.name.clone()).collect(),
            keyframes: self.map.keyframes.len() as u64,
            frames: self.map.frames.len() as u64,
            localised_only: self.mode == ResumeMode::Localising,
        }
    }
}

/// The index by which an agent finds its own places again.
pub fn places() -> Box<dyn PlaceIndex> {
    Box::new(ThumbnailIndex::default())
}

/// An agent whose map of so many keyframes a further session extends from frame `first_index` on: where both came from is
/// kept.
fn extended(info: &AgentInfo, session: &AgentInfo, keyframes: usize, first_index: u64) -> AgentInfo {
    let mut about = info.clone();
    let number = next_number(&about.provenance, "continued", "source");
    let of_session = session.provenance.iter().map(|(key, value)| (key.clone(), value.clone()));
    let counts = [("first keyframe", keyframes as u64), ("first frame", first_index)];
    let counts = counts.map(|(key, count)| (key.to_owned(), count.to_string()));
    for (key, value) in of_session.chain(counts) {
        about.provenance.insert(format!("continued {number}: {key}"), value);
    }
    about
}

/// The number of what is `done` next to a map, whose provenance tells `key` of each time before.
fn next_number(provenance: &BTreeMap<String, String>, done: &str, key: &str) -> usize {
    let is_recorded = |number: &usize| provenance.contains_key(&format!("{done} {number}: {key}"));
    (1..).take_while(is_recorded).count() + 1
}

/// A common map made anew of its agents' own maps and the closures between them; `None` where these do not join all of them.
fn made_anew(map: &Map) -> Option<Map> {
    let (common, _) = CommonMap::from_maps(&[map]).ok()?;
    let [fused] = <[Fused; 1]>::try_from(common.fuse(&FusionParams::default()).ok()?).ok()?;
    Some(Map { merge_provenance: map.merge_provenance.clone(), ..fused.map })
}

/// Makes sure that all of a map was made with the camera of the images.
fn refuse_other_cameras(file: &Path, map: &Map, camera: &Pinhole, session: &AgentInfo) -> Result<()> {
    for info in map.agents.values() {
        let Some(own) = info.camera().filter(|own| !is_same(own, camera)) else { continue };
        let part =
            if map.agents.len() == 1 { String::new() } else { format!("the part of {} in it ", info.name) };
        bail!(
            "{}: {part}was made with a camera of {}, the images of {} are those of one of {}\nhint: a map is continued by the \
             camera that made it; --calib takes its calibration",
            file.display(),
            text(own),
            session.name,
            text(camera)
        );
    }
    Ok(())
}

fn is_same(one: &Pinhole, other: &Pinhole) -> bool {
    let numbers = |c: &Pinhole| [c.fx, c.fy, c.cx, c.cy];
    let similar = numbers(one).iter().zip(numbers(other)).all(|(a, b)| (a - b).abs() < SAME);
    (one.width, one.height) == (other.width, other.height) && similar
}

fn text(camera: &Pinhole) -> String {
    let Pinhole { width, height, fx, fy, cx, cy } = camera;
    format!("{width} × {height} pixels with focal lengths {fx:.2} and {fy:.2} and centre {cx:.2}, {cy:.2}")
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };

    #[test]
    fn every_session_is_kept_in_the_provenance() {
        let session = |source: &str| AgentInfo {
            provenance: [("source".to_owned(), source.to_owned())].into(),
            ..AgentInfo::new(source, CAMERA)
        };
        let twice = extended(&extended(&session("one"), &session("two"), 0, 0), &session("three"), 0, 0);
        let value = |key: &str| twice.provenance.get(key).map(String::as_str);
        assert_eq!((twice.name.as_str(), value("source")), ("one", Some("one")));
        assert_eq!(
            (value("continued 1: source"), value("continued 2: source"), value("continued 2: first frame")),
            (Some("two"), Some("three"), Some("0"))
        );
    }

    #[test]
    fn a_camera_is_the_same_to_the_last_digits_a_file_may_lose() {
        assert!(is_same(&CAMERA, &Pinhole { fx: 8.0 + 1e-9, ..CAMERA }));
        assert!(!is_same(&CAMERA, &Pinhole { fx: 8.01, ..CAMERA }));
        assert!(!is_same(&CAMERA, &Pinhole { width: 9, ..CAMERA }));
    }
}
