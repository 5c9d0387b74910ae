//! The thread that brings a store's objects and heads to the disk, those that come within a moment together: then a version
//! of a map costs two syncs, however many objects it has, and those of several agents cost no more.

use super::shared::{Inner, Job, State};
use super::{Head, StoreEvent, locked};
use crate::hash::ObjectHash;
use map::Identity;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How long objects wait for others, at the most, and how many bytes of them; a head has them written at once.
const GATHER: Duration = Duration::from_millis(500);
const GATHERED: usize = 8 << 20;
/// How long nothing is tried after the disk refused.
const PAUSE: Duration = Duration::from_millis(if cfg!(test) { 20 } else { 3000 });

/// The writing thread.
pub(super) struct Writer(pub Arc<Inner>);

/// Jobs that share their syncs.
#[derive(Default)]
struct Batch {
    /// Objects, and whether they are still to be given their names.
    objects: BTreeMap<ObjectHash, bool>,
    heads: BTreeMap<Identity, Head>,
}

impl Writer {
    /// Writes until the store ends, and then once more.
    pub fn work(&self) {
        while let Some(mut jobs) = self.next() {
            let Err(error) = self.write(&mut jobs) else { continue };
            let mut state = locked(&self.0.state);
            state.events.push(StoreEvent::Failed(error.to_string()));
            for job in jobs.into_iter().rev() {
                state.jobs.push_front(job);
            }
            state.since = Some(Instant::now());
            let pause = self.0.changed.wait_timeout_while(state, PAUSE, |state| !state.ends);
            if pause.unwrap_or_else(PoisonError::into_inner).0.ends {
                return;
            }
        }
    }

    /// What is to be done next, once it is time; `None` when all is done and the store ends.
    fn next(&self) -> Option<VecDeque<Job>> {
        let mut state = locked(&self.0.state);
        if std::mem::take(&mut state.is_at_work) {
            self.0.changed.notify_all();
        }
        loop {
            let is_urgent = |state: &State| {
                let has_head = state.jobs.iter().any(|job| matches!(job, Job::Head(..)));
                let is_wished = state.is_urgent && !state.jobs.is_empty();
                state.ends || has_head || is_wished || state.waiting_bytes >= GATHERED
            };
            let left = state.since.map(|since| GATHER.saturating_sub(since.elapsed()));
            if is_urgent(&state) || left.is_some_and(|left| left.is_zero()) {
                state.since = None;
                let jobs = std::mem::take(&mut state.jobs);
                state.is_at_work = true;
                return (!jobs.is_empty() || !state.ends).then_some(jobs);
            }
            state = self.wait(state, left.unwrap_or(Duration::MAX));
        }
    }

    fn wait<'a>(&'a self, state: MutexGuard<'a, State>, time: Duration) -> MutexGuard<'a, State> {
        // Seconds that no clock knows are too many.
        let time = time.min(Duration::from_secs(3600));
        self.0.changed.wait_timeout(state, time).unwrap_or_else(PoisonError::into_inner).0
    }

    /// Does what is to be done. What is left of it when the disk refuses is among `jobs` afterwards.
    fn write(&self, jobs: &mut VecDeque<Job>) -> io::Result<()> {
        let mut batch = Batch::default();
        let mut refused = Ok(());
        let mut done = VecDeque::new();
        while let Some(job) = jobs.pop_front() {
            match job {
                Job::Write(hash) => match self.write_object(&hash) {
                    Ok(Some(is_new)) => drop(batch.objects.insert(hash, is_new)),
                    Ok(None) => {}
                    Err(error) => {
                        jobs.push_front(job);
                        refused = Err(error);
                        break;
                    }
                },
                Job::Remove(hash) => {
                    batch.objects.remove(&hash);
                    self.0.disk.remove(&self.0.file(&hash));
                    self.0.disk.remove(&self.0.new_file(&hash));
                }
                Job::Head(agent, head) => drop(batch.heads.insert(agent, head)),
            }
            done.push_back(job);
        }
        // What was written while others did not fit is kept: there is no room for it twice.
        if let Err(error) = self.commit(&batch) {
            done.append(jobs);
            *jobs = done;
            return Err(error);
        }
        refused
    }

    /// Writes an object that waits, unless it is there already, whose name may not be on the disk yet; whether it is to be
    /// given its name.
    fn write_object(&self, hash: &ObjectHash) -> io::Result<Option<bool>> {
        let waiting = locked(&self.0.state).waiting.get(hash).cloned();
        // Removed meanwhile: nobody wants it any more.
        let Some(bytes) = waiting else { return Ok(None) };
        if self.0.disk.read(&self.0.file(hash)).is_ok_and(|there| there == *bytes) {
            return Ok(Some(false));
        }
        self.0.disk.write(&self.0.new_file(hash), &bytes)?;
        Ok(Some(true))
    }

    /// Gives written objects their names once their content is on the disk, and heads once these names are.
    fn commit(&self, batch: &Batch) -> io::Result<()> {
        let disk = &self.0.disk;
        let new = batch.objects.iter().filter(|(_, is_new)| **is_new);
        let mut files: Vec<PathBuf> = new.map(|(hash, _)| self.0.new_file(hash)).collect();
        let mut heads = Vec::new();
        for (agent, head) in &batch.heads {
            let (path, text) = self.0.head_file(*agent, *head);
            let temporary = path.with_extension("tmp");
            disk.write(&temporary, text.as_bytes())?;
            files.push(temporary.clone());
            heads.push((temporary, path));
        }
        disk.sync(&files)?;
        let mut folders = BTreeSet::new();
        for (hash, is_new) in &batch.objects {
            let file = self.0.file(hash);
            if *is_new {
                disk.rename(&self.0.new_file(hash), &file)?;
            }
            // A folder that is new has a name itself.
            folders.extend(file.ancestors().skip(1).take(2).map(Path::to_owned));
        }
        disk.sync(&folders.into_iter().collect::<Vec<_>>())?;
        let mut state = locked(&self.0.state);
        batch.objects.keys().for_each(|hash| state.written(hash));
        drop(state);
        for (temporary, path) in &heads {
            disk.rename(temporary, path)?;
        }
        let folder = heads.first().and_then(|(_, path)| path.parent());
        disk.sync(&folder.into_iter().map(Path::to_owned).collect::<Vec<_>>())?;
        let mut state = locked(&self.0.state);
        for (agent, head) in &batch.heads {
            state.heads.insert(*agent, *head);
            state.events.push(StoreEvent::Head(*agent, *head));
        }
        Ok(())
    }
}
