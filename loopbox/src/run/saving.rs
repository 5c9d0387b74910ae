//! Results of a run that goes on: those saved on the way, and those of the maps after the first.

use crate::run::output::{Output, TrajectoryFormat};
use crate::run::record::RunRecord;
use anyhow::{Result, bail};
use map::{AgentInfo, Map};
use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

/// The form of results.
#[derive(Clone, Copy, Debug)]
pub struct Form {
    /// Form of the trajectory.
    pub format: TrajectoryFormat,
    /// Points of the cloud with a larger relative variance are left out.
    pub max_variance: f32,
}

/// Saves results aside, in a thread, so that the run need not wait.
pub struct Saver {
    agent: AgentInfo,
    form: Form,
    /// One at a time: what is being saved.
    thread: RefCell<Option<JoinHandle<()>>>,
    /// A thread ended in a panic.
    broke: Cell<bool>,
}

impl Saver {
    /// Saves maps of this agent.
    pub fn new(agent: AgentInfo, form: Form) -> Self {
        Self { agent, form, thread: RefCell::new(None), broke: Cell::new(false) }
    }

    /// Begins to write all results into the folder `saved-FRAME` within that of the run; says by `tell` what
    /// became of it.
    pub fn save(&self, folder: &Path, map: Map, record: RunRecord, tell: impl Fn(String) + Send + 'static) {
        let mut thread = self.thread.borrow_mut();
        if thread.as_ref().is_some_and(|thread| !thread.is_finished()) {
            return tell("still saving: try again in a moment".into());
        }
        self.join(thread.take());
        let newest = record.rows.last().map_or(0, |row| row.index);
        let target = folder.join(format!("saved-{newest:06}"));
        let (agent, form) = (self.agent.clone(), self.form);
        let of_thread = move || {
            if map.frames.is_empty() {
                return tell("nothing was tracked yet that could be saved".into());
            }
            tell("saving …".into());
            match write_whole(&target, agent, map, record, form) {
                Ok(()) => tell(format!("saved to {}", target.display())),
                Err(error) => tell(format!("not saved: {error:#}")),
            }
        };
        *thread = std::thread::Builder::new().name("save".into()).spawn(of_thread).ok();
    }

    /// Waits until what is being saved is on the disk.
    ///
    /// # Errors
    /// When saving broke down.
    pub fn end(&self) -> Result<()> {
        self.join(self.thread.borrow_mut().take());
        if self.broke.get() {
            bail!("internal error in saving during the run, please report it");
        }
        Ok(())
    }

    /// Notes how the thread ended.
    fn join(&self, thread: Option<JoinHandle<()>>) {
        let broke = thread.is_some_and(|thread| thread.join().is_err());
        self.broke.set(self.broke.get() || broke);
    }
}

impl Drop for Saver {
    fn drop(&mut self) {
        // Whoever wants to know has asked `end`.
        let _ = self.end();
    }
}

/// Writes a folder of results that appear when they are whole.
fn write_whole(target: &Path, agent: AgentInfo, map: Map, mut record: RunRecord, form: Form) -> Result<()> {
    let mut output = Output::create(target, agent, Path::new(&record.source.path), true)?;
    let trajectories = [map.trajectory()];
    output.finish(&[map], &trajectories, &mut record, form.format, form.max_variance)
}

/// The folder for the next map of a run that began with `first`: the first of `first-2`, `first-3`, … that is not
/// there yet.
pub fn next_folder(first: &Path) -> PathBuf {
    // A path such as `.` has no name of its own before it is made whole.
    let whole = first.canonicalize();
    let base = if first.file_name().is_some() { first } else { whole.as_deref().unwrap_or(first) };
    let name = base.file_name().map_or_else(|| "map".into(), |name| name.to_string_lossy());
    let numbered = |number: u32| base.with_file_name(format!("{name}-{number}"));
    let mut number = 2;
    while numbered(number).exists() {
        number += 1;
    }
    numbered(number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_next_folder_is_next_to_the_first_and_new() {
        let room = tempfile::tempdir().expect("a folder");
        let first = room.path().join("mine");
        assert_eq!(next_folder(&first), room.path().join("mine-2"));
        std::fs::create_dir(room.path().join("mine-2")).expect("it can be made");
        assert_eq!(next_folder(&first), room.path().join("mine-3"));
        assert_eq!(next_folder(&room.path().join("mine/")), room.path().join("mine-3"));
    }
}
