//! Asks the pairs of a store's maps for their verdicts. Several workers on one store share the pairs without a word: each takes them in an
//! order of its own, drawn by chance, and leaves out those whose verdict is there by then. A pair that two take at once gets one verdict, as
//! both find the same to the byte. A verdict is put whole or not at all, so that a worker may be killed at any moment.

use super::Store;
use crate::blobs::{Blobs, FolderBlobs, Place};
use crate::lidar;
use crate::lidar::merging::LidarMergeParams;
use crate::lidar::merging::verdicts::lidar_key;
use crate::merging::verdicts::camera_key;
use crate::merging::{MergeWatcher, MergingParams};
use crate::open::{Sensors, open_map, sensors_at};
use crate::pairs::{VerdictOptions, VerdictReport, find_verdict};
use crate::verdicts::MapDigest;
use anyhow::{Context, Result, bail};
use sources::Stop;
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// How often it is looked for new maps and others' verdicts.
const LOOK: Duration = Duration::from_secs(2);
/// A file that was not written for so long is whole.
const SETTLED: Duration = Duration::from_secs(10);
/// How often a wish to stop is asked for while there is nothing to do.
const NAP: Duration = Duration::from_millis(100);

/// What a worker is to do.
#[derive(Clone, Debug, Default)]
pub struct WorkOptions {
    /// The store: a folder, which is made if it is not there, or the URI of a bucket.
    pub store: PathBuf,
    /// How pairs of cameras' maps are judged.
    pub cameras: MergingParams,
    /// How pairs of LiDARs' maps are judged.
    pub lidars: LidarMergeParams,
    /// Ends it once every pair of the maps that are there has its verdict.
    pub once: bool,
}

/// What a worker did.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Pairs of maps that it asked.
    pub asked: usize,
    /// The maps and pairs that it left out, and why.
    pub left_out: Vec<String>,
}

/// Asks the pairs of a store's maps whose verdicts are not there, and puts these there, until `stop` is wished, or with
/// [`once`](WorkOptions::once) until all are there. `watcher` is told of every pair that was asked, and warned of what is left out.
///
/// # Errors
/// When the store cannot be used. Without `once` it is warned of a store that fails later, and tried again.
pub fn work(options: &WorkOptions, stop: &Stop, watcher: &dyn MergeWatcher) -> Result<Work> {
    let mut worker = Worker::new(options, stop, watcher)?;
    let mut trouble = String::new();
    while !stop.requested() {
        match worker.round() {
            Ok(true) if options.once => break,
            Ok(_) if worker.waiting.is_empty() => worker.rest(),
            Ok(_) => {}
            Err(error) if options.once => return Err(error),
            Err(error) => {
                let text = crate::explained(&error);
                if std::mem::replace(&mut trouble, text.clone()) != text {
                    watcher.warn(&format!("{text}\nit is tried again"));
                }
                worker.rest();
                continue;
            }
        }
        trouble.clear();
    }
    Ok(worker.work)
}

/// A map of the store.
#[derive(Debug)]
enum Entry {
    /// It may be on its way, and has been like that since then.
    Arriving(Stamp, Instant),
    /// It is asked.
    Ready(Stamp, ReadyMap),
    /// It is none that could be asked.
    LeftOut(Stamp),
}

/// When a file was written, and its length; nothing of an object in a bucket, which is whole and does not change.
type Stamp = Option<(SystemTime, u64)>;

#[derive(Debug)]
struct ReadyMap {
    file: PathBuf,
    sensors: Sensors,
    /// Its agents; of a camera's map one that stands for all.
    agents: Vec<MapDigest>,
}

/// Two maps that are to be asked.
#[derive(Debug)]
struct Pair {
    maps: [String; 2],
    /// The names of its verdicts: of maps with several LiDARs one for each two agents.
    verdicts: Vec<String>,
    /// Where it stands in the order of this worker.
    order: u64,
}

struct Worker<'a> {
    options: &'a WorkOptions,
    stop: &'a Stop,
    watcher: &'a dyn MergeWatcher,
    warned: Warned<'a>,
    store: Store,
    maps: BTreeMap<String, Entry>,
    /// The pairs whose verdicts were not there when it was looked last, the next one last.
    waiting: Vec<Pair>,
    /// Where verdicts are until they are in the store.
    room: tempfile::TempDir,
    order: RandomState,
    work: Work,
}

impl<'a> Worker<'a> {
    fn new(options: &'a WorkOptions, stop: &'a Stop, watcher: &'a dyn MergeWatcher) -> Result<Self> {
        let store = Store::at(&options.store)?;
        let room =
            tempfile::tempdir().context("there is no room for a verdict in the folder of temporary files")?;
        let (maps, waiting, order, work) = Default::default();
        let warned = Warned { watcher, warned: RefCell::default() };
        Ok(Self { options, stop, watcher, warned, store, maps, waiting, room, order, work })
    }

    /// Looks what is there, and asks pairs until it is time to look again. Whether nothing is left, and nothing on its way.
    fn round(&mut self) -> Result<bool> {
        let begun = Instant::now();
        // What could not be put before is not found again.
        self.deliver()?;
        let are_whole = self.take_in()?;
        let there = self.store.verdicts()?;
        self.waiting.retain(|pair| !pair.verdicts.iter().all(|name| there.contains(name)));
        while begun.elapsed() < LOOK && !self.stop.requested() {
            let Some(pair) = self.waiting.pop() else { break };
            if let Err(error) = self.ask(&pair) {
                self.waiting.push(pair);
                return Err(error);
            }
        }
        Ok(are_whole && self.waiting.is_empty())
    }

    /// Waits until it is time to look again.
    fn rest(&self) {
        let begun = Instant::now();
        while begun.elapsed() < LOOK && !self.stop.requested() {
            std::thread::sleep(NAP);
        }
    }

    /// Takes in the maps that are new or changed. Whether all are whole.
    fn take_in(&mut self) -> Result<bool> {
        let names = self.store.maps()?;
        self.maps.retain(|name, _| names.contains(name));
        let mut arrived = Vec::new();
        for name in &names {
            let stamp = self.stamp(name)?;
            let before = self.maps.get(name);
            let is_known = before.is_some_and(|entry| entry.stamp() == stamp && !entry.is_arriving());
            if is_known || self.stop.requested() {
                continue;
            }
            let since = match before {
                Some(Entry::Arriving(before, since)) if *before == stamp => *since,
                _ => Instant::now(),
            };
            if since.elapsed() < LOOK && may_be_written(name, stamp) {
                self.maps.insert(name.clone(), Entry::Arriving(stamp, since));
                continue;
            }
            let file = self.store.file(name, &|text| self.watcher.stage(text))?;
            let entry = match ReadyMap::read(name, file) {
                Ok(map) => Entry::Ready(stamp, map),
                Err(error) => {
                    self.leave_out(crate::explained(&error));
                    Entry::LeftOut(stamp)
                }
            };
            self.maps.insert(name.clone(), entry);
            arrived.push(name.clone());
        }
        let is_there = |name: &String| matches!(self.maps.get(name), Some(Entry::Ready(..)));
        self.waiting.retain(|pair| pair.maps.iter().all(|map| is_there(map) && !arrived.contains(map)));
        self.pair_up(&arrived);
        Ok(!self.maps.values().any(Entry::is_arriving))
    }

    /// When a map's file was written, where it is on this machine.
    fn stamp(&self, name: &str) -> Result<Stamp> {
        let Place::Local(folder) = Place::of(&self.options.store)? else {
            return Ok(None);
        };
        // One that is gone by now is not among the next names.
        let about = fs::metadata(folder.join(name)).ok();
        Ok(about.and_then(|about| Some((about.modified().ok()?, about.len()))))
    }

    /// Has the pairs of these maps, with each other and with all others, asked.
    fn pair_up(&mut self, arrived: &[String]) {
        for (number, name) in arrived.iter().enumerate() {
            let Some(Entry::Ready(_, map)) = self.maps.get(name) else { continue };
            for (other, entry) in &self.maps {
                let Entry::Ready(_, partner) = entry else { continue };
                if other == name || arrived[..number].contains(other) || partner.sensors != map.sensors {
                    continue;
                }
                let verdicts = self.verdicts_of([map, partner]);
                let order = self.order.hash_one(&verdicts);
                self.waiting.push(Pair { maps: [name.clone(), other.clone()], verdicts, order });
            }
        }
        self.waiting.sort_by_key(|pair| pair.order);
    }

    /// What the verdicts on two maps are called.
    fn verdicts_of(&self, [a, b]: [&ReadyMap; 2]) -> Vec<String> {
        let both = a.agents.iter().flat_map(|a| b.agents.iter().map(move |b| [a, b]));
        let key = |maps: [&MapDigest; 2]| match a.sensors {
            Sensors::Lidars => lidar_key(maps, &self.options.lidars),
            _ => camera_key(maps, &self.options.cameras),
        };
        both.map(|maps| key(maps).object()).collect()
    }

    /// Asks a pair, unless somebody has meanwhile; what is wrong with it is told.
    ///
    /// # Errors
    /// When the store cannot be read or written.
    fn ask(&mut self, pair: &Pair) -> Result<()> {
        let mut there = true;
        for name in &pair.verdicts {
            there &= self.store.has_verdict(name)?;
        }
        let ready = |name: &String| match self.maps.get(name) {
            Some(Entry::Ready(_, map)) => Some(map.file.clone()),
            _ => None,
        };
        let [Some(a), Some(b)] = pair.maps.each_ref().map(ready) else { return Ok(()) };
        if there {
            return Ok(());
        }
        match self.find([a, b]) {
            Ok(report) => {
                self.work.asked += 1;
                report
                    .text
                    .lines()
                    .filter(|line| !line.starts_with(' '))
                    .for_each(|line| self.watcher.stage(line));
                self.deliver()
            }
            // Nothing was put.
            Err(_) if self.stop.requested() => Ok(()),
            Err(error) => {
                self.blame(pair, &error);
                Ok(())
            }
        }
    }

    fn find(&self, maps: [PathBuf; 2]) -> Result<VerdictReport> {
        let (cameras, lidars) = (self.options.cameras.clone(), self.options.lidars.clone());
        let verdicts = Some(self.room.path().to_owned());
        let options = VerdictOptions { cameras, lidars, verdicts, confirm: Vec::new() };
        find_verdict(&maps, &options, self.stop, &self.warned)
    }

    /// Puts the verdicts that were found into the store.
    ///
    /// # Errors
    /// When it cannot be written; they stay here.
    fn deliver(&self) -> Result<()> {
        let found = FolderBlobs::at(self.room.path())?;
        for name in found.list("")? {
            if let Some(bytes) = found.get(&name)? {
                self.store.put_verdict(&name, &bytes)?;
            }
            let file = self.room.path().join(&name);
            fs::remove_file(&file).with_context(|| format!("{}: cannot be removed", file.display()))?;
        }
        Ok(())
    }

    /// Finds out which of two maps cannot be read, and leaves that out, or both together where each can.
    fn blame(&mut self, pair: &Pair, error: &anyhow::Error) {
        let mut is_found = false;
        for name in &pair.maps {
            let Some(Entry::Ready(stamp, map)) = self.maps.get(name) else { continue };
            let (stamp, Err(error)) = (*stamp, open_map(&map.file)) else { continue };
            is_found = true;
            self.leave_out(crate::explained(&error));
            self.maps.insert(name.clone(), Entry::LeftOut(stamp));
        }
        if !is_found {
            let [a, b] = &pair.maps;
            self.leave_out(format!("{a} and {b}: {}", crate::explained(error)));
        }
    }

    fn leave_out(&mut self, why: String) {
        self.watcher.warn(&format!("left out: {why}"));
        self.work.left_out.push(why);
    }
}

impl Entry {
    fn stamp(&self) -> Stamp {
        let (Self::Arriving(stamp, _) | Self::Ready(stamp, _) | Self::LeftOut(stamp)) = self;
        *stamp
    }

    fn is_arriving(&self) -> bool {
        matches!(self, Self::Arriving(..))
    }
}

impl ReadyMap {
    /// Reads what is asked of a map before its pairs are.
    ///
    /// # Errors
    /// When it cannot be read, holds agents of both kinds, or is not what its name says.
    fn read(name: &str, file: PathBuf) -> Result<Self> {
        map::sensors_of(&file)?;
        let digest = MapDigest::of(&file)?;
        if is_hash(name) && !name.contains(digest.as_str()) {
            bail!(
                "{}: is not what was put under this name\nhint: delete it, and have it put again",
                file.display()
            );
        }
        let sensors = sensors_at(std::slice::from_ref(&file));
        let agents = match sensors {
            Sensors::Cameras => vec![digest],
            Sensors::Lidars => {
                match lidar::read_inputs(std::slice::from_ref(&file), &mut |_| Ok(()))?.0.len() {
                    1 => vec![digest],
                    count => (0..count).map(|number| digest.of_agent(number)).collect(),
                }
            }
            Sensors::Mixed => bail!(
                "{}: holds agents of both kinds; `loopbox unmerge` gives each agent's own map",
                file.display()
            ),
        };
        Ok(Self { file, sensors, agents })
    }
}

/// Whether a map is called by its SHA-256, as [`Store::put_map`] does.
fn is_hash(name: &str) -> bool {
    let stem = Path::new(name).file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
    stem.len() == 64 && stem.bytes().all(|byte| byte.is_ascii_hexdigit())
}

/// Whether a map's file may still be written: not one that was put by its SHA-256, which comes whole.
fn may_be_written(name: &str, stamp: Stamp) -> bool {
    let Some((written, _)) = stamp.filter(|_| !is_hash(name)) else { return false };
    // A file of the future says nothing.
    SystemTime::now().duration_since(written).map_or(true, |age| age < SETTLED)
}

/// Passes on warnings, each once whatever pair a map is in, and stages as details.
struct Warned<'a> {
    watcher: &'a dyn MergeWatcher,
    warned: RefCell<BTreeSet<String>>,
}

impl MergeWatcher for Warned<'_> {
    fn stage(&self, text: &str) {
        self.watcher.detail(text);
    }

    fn warn(&self, text: &str) {
        if self.warned.borrow_mut().insert(text.to_owned()) {
            self.watcher.warn(text);
        }
    }
}
