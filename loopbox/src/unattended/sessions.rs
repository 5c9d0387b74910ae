//! The folders of an agent's sessions: `000001`, `000002`, … in the folder `out`, each with its map and its recordings.
//!
//! A map that cannot be read is renamed to `NAME.unreadable`, with the reason in `NAME.unreadable.txt`: it goes when its
//! session does. `agent.json` holds what the next start must know of the ones before.

use super::room::Kept;
use crate::results::{lock, map_in};
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use sources::recording::number_of;
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Digits of a session's number.
const DIGITS: usize = 6;
/// What a map that cannot be read is called, behind its name.
const UNREADABLE: &str = "unreadable";
/// What is known of earlier starts.
const HISTORY: &str = "agent.json";
/// So many starts may read a map without coming to their first frame; then it is left as it is.
const READINGS: u32 = 3;

/// The folder of all sessions; nobody else may work there meanwhile.
pub struct Sessions {
    out: PathBuf,
    _lock: Option<File>,
}

/// One session.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Session {
    /// Its number, from 1.
    pub number: u32,
    /// Its folder.
    pub folder: PathBuf,
}

/// What a start must know of those before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct History {
    /// Maps of sessions up to this one are not gone on with: they have outgrown the machine.
    pub left: u32,
    /// The session whose map is being read, until the first frame is tracked or not.
    pub reading: u32,
    /// How often in a row that came to nothing.
    pub readings: u32,
}

impl History {
    /// Whether the map of a session may be gone on with.
    pub fn allows(&self, session: u32) -> bool {
        session > self.left && !(session == self.reading && self.readings >= READINGS)
    }

    /// The same, once the map of a session is about to be read.
    pub fn reading(self, session: u32) -> Self {
        let readings = if session == self.reading { self.readings + 1 } else { 1 };
        Self { reading: session, readings, ..self }
    }

    /// The same, once that went well.
    pub fn read(self) -> Self {
        Self { reading: 0, readings: 0, ..self }
    }

    /// The same, where the map of a session and those before are left.
    pub fn without_maps_until(self, session: u32) -> Self {
        Self { left: self.left.max(session), ..self }
    }
}

impl Sessions {
    /// Makes the folder, and keeps others from working there.
    ///
    /// # Errors
    /// When it cannot be made, or another program works there.
    pub fn open(out: &Path) -> Result<Self> {
        fs::create_dir_all(out).with_context(|| {
            format!(
                "{}: the folder cannot be made\nhint: `out` must name one that can be written to",
                out.display()
            )
        })?;
        Ok(Self { out: out.to_owned(), _lock: lock(out)? })
    }

    /// All sessions, the oldest first.
    pub fn all(&self) -> Vec<Session> {
        let entries = fs::read_dir(&self.out).into_iter().flatten().flatten();
        let mut all: Vec<Session> = entries
            .filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir()))
            .filter_map(|entry| Some(Session { number: number(&entry.file_name())?, folder: entry.path() }))
            .collect();
        all.sort();
        all
    }

    /// The next session; its folder is not made yet.
    pub fn next(&self) -> Session {
        let number = self.all().last().map_or(1, |last| last.number + 1);
        Session { number, folder: self.out.join(format!("{number:0DIGITS$}")) }
    }

    /// The folder of the newest session with a map that may be gone on with.
    pub fn newest_with_map(&self) -> Option<PathBuf> {
        let history = self.history();
        let has_map = |session: &Session| history.allows(session.number) && !session.maps().is_empty();
        self.all().into_iter().rev().find(has_map).map(|session| session.folder)
    }

    /// What is known of earlier starts.
    pub fn history(&self) -> History {
        let text = fs::read(self.out.join(HISTORY)).unwrap_or_default();
        serde_json::from_slice(&text).unwrap_or_default()
    }

    /// Keeps what the next start must know. On a full disk it is not kept, which only a crash would miss.
    pub fn keep_history(&self, history: &History) {
        let Ok(text) = serde_json::to_vec(history) else { return };
        let _ = write_whole(&self.out.join(HISTORY), &text);
    }

    /// All that is kept, the oldest first, with recordings before the map of their session; `in_use` says what must stay.
    pub fn kept(&self, in_use: &dyn Fn(&Path) -> bool) -> Vec<Kept<PathBuf>> {
        let mut kept = Vec::new();
        for session in self.all() {
            let recordings = session.recordings();
            let mut rest = bytes_in(&session.folder);
            let mut is_in_use = in_use(&session.folder);
            for path in recordings {
                let bytes = fs::metadata(&path).map_or(0, |about| about.len());
                let in_use = in_use(&path);
                is_in_use |= in_use;
                rest = rest.saturating_sub(bytes);
                kept.push(Kept { what: path, bytes, in_use });
            }
            kept.push(Kept { what: session.folder, bytes: rest, in_use: is_in_use });
        }
        kept
    }

    /// Bytes in the folder that are no session's: of what agents told each other, say.
    pub fn other_bytes(&self) -> u64 {
        let sessions: u64 = self.all().iter().map(|session| bytes_in(&session.folder)).sum();
        bytes_in(&self.out).saturating_sub(sessions)
    }

    /// Removes sessions that hold neither a map nor a recording, but for those that are to stay.
    pub fn remove_empty(&self, stays: &dyn Fn(&Path) -> bool) {
        let is_empty = |session: &Session| session.maps().is_empty() && session.recordings().is_empty();
        let has_unreadable = |session: &Session| session.names().any(|name| name.ends_with(UNREADABLE));
        for session in self.all() {
            if !stays(&session.folder) && is_empty(&session) && !has_unreadable(&session) {
                let _ = fs::remove_dir_all(&session.folder);
            }
        }
    }
}

impl Session {
    fn names(&self) -> impl Iterator<Item = String> {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned())
    }

    /// Its recordings, the oldest first.
    pub fn recordings(&self) -> Vec<PathBuf> {
        let mut numbered: Vec<(u32, PathBuf)> =
            self.names().filter_map(|name| Some((number_of(&name)?, self.folder.join(name)))).collect();
        numbered.sort();
        numbered.into_iter().map(|(_, path)| path).collect()
    }

    /// Its maps: that of the session first, then those of what was seen apart from it.
    pub fn maps(&self) -> Vec<PathBuf> {
        let first = map_in(&self.folder).map(|(path, _)| path);
        let mut others: Vec<(u32, PathBuf)> = self
            .names()
            .filter_map(|name| {
                let number = name.strip_prefix("map-")?.strip_suffix(".mcap")?.parse().ok()?;
                Some((number, self.folder.join(name)))
            })
            .collect();
        others.sort();
        first.into_iter().chain(others.into_iter().map(|(_, path)| path)).collect()
    }
}

/// Keeps a map that cannot be read under another name, with the reason.
///
/// # Errors
/// When it cannot be renamed.
pub fn set_aside(map: &Path, reason: &str) -> Result<PathBuf> {
    let named = |more: &str| {
        let mut name = map.file_name().unwrap_or_default().to_owned();
        name.push(more);
        map.with_file_name(name)
    };
    let aside = named(&format!(".{UNREADABLE}"));
    fs::rename(map, &aside).with_context(|| format!("{}: cannot be set aside", map.display()))?;
    // Without the reason it is aside all the same.
    let _ = fs::write(named(&format!(".{UNREADABLE}.txt")), format!("{reason}\n"));
    Ok(aside)
}

/// Writes a small file so that it is whole or as it was, whatever happens.
///
/// # Errors
/// When the system refuses.
pub fn write_whole(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let partial = path.with_extension("tmp");
    let write = || {
        let mut file = File::create(&partial)?;
        file.write_all(bytes)?;
        file.sync_data()?;
        fs::rename(&partial, path)
    };
    write().inspect_err(|_| drop(fs::remove_file(&partial)))
}

/// The number of a session by the name of its folder.
fn number(name: &std::ffi::OsStr) -> Option<u32> {
    let name = name.to_str()?;
    let is_number = name.len() >= DIGITS && name.bytes().all(|byte| byte.is_ascii_digit());
    is_number.then(|| name.parse().ok()).flatten().filter(|&number| number > 0)
}

/// Bytes of all files in a folder and those within it.
fn bytes_in(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let bytes = entries.map(|entry| match entry.metadata() {
        Ok(about) if about.is_dir() => bytes_in(&entry.path()),
        Ok(about) => about.len(),
        Err(_) => 0,
    });
    bytes.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: PathBuf, bytes: usize) {
        fs::create_dir_all(path.parent().expect("not the root")).expect("there is room");
        fs::write(path, vec![0; bytes]).expect("there is room");
    }

    #[test]
    fn sessions_are_counted_and_their_files_distinguished() {
        let room = tempfile::tempdir().expect("a folder");
        let at = |name: &str| room.path().join(name);
        let sessions = Sessions::open(room.path()).expect("it is ours");
        assert_eq!(sessions.next().folder, at("000001"));
        write(at("000002/map.mcap"), 10);
        write(at("000002/map-2.mcap"), 5);
        write(at("000002/recording-9.mcap"), 7);
        write(at("000002/recording-10.mcap"), 8);
        write(at("000011/unfinished/map.mcap"), 3);
        write(at("000012/run.json"), 1);
        write(at("photos/one.png"), 100);
        let all = sessions.all();
        assert_eq!(all.iter().map(|session| session.number).collect::<Vec<_>>(), [2, 11, 12]);
        assert_eq!(sessions.next().number, 13);
        assert_eq!(all[0].maps(), [at("000002/map.mcap"), at("000002/map-2.mcap")]);
        assert_eq!(all[1].maps(), [at("000011/unfinished/map.mcap")]);
        let recordings = all[0].recordings();
        assert_eq!(recordings, [at("000002/recording-9.mcap"), at("000002/recording-10.mcap")]);
        assert_eq!(sessions.other_bytes(), 100);
        let kept = sessions.kept(&|path| path == at("000002/recording-10.mcap"));
        let found: Vec<_> = kept.iter().map(|one| (one.bytes, one.in_use)).collect();
        assert_eq!(found, [(7, false), (8, true), (15, true), (3, false), (1, false)]);
        sessions.remove_empty(&|_| false);
        assert_eq!(sessions.all().len(), 2);
    }

    #[test]
    fn two_agents_do_not_share_a_folder() {
        let room = tempfile::tempdir().expect("a folder");
        let _one = Sessions::open(room.path()).expect("it is ours");
        assert!(Sessions::open(room.path()).is_err());
    }

    #[test]
    fn a_map_is_set_aside_with_its_reason() {
        let room = tempfile::tempdir().expect("a folder");
        let map = room.path().join("000001/map.mcap");
        write(map.clone(), 4);
        let aside = set_aside(&map, "it is torn").expect("it can be renamed");
        assert!(!map.exists() && aside.ends_with("000001/map.mcap.unreadable"));
        let reason = fs::read_to_string(map.with_file_name("map.mcap.unreadable.txt"));
        assert_eq!(reason.expect("it was written"), "it is torn\n");
        let sessions = Sessions::open(room.path()).expect("it is ours");
        sessions.remove_empty(&|_| false);
        assert!(aside.exists(), "it stays until there is no room");
        assert!(sessions.all()[0].maps().is_empty());
    }

    #[test]
    fn a_map_that_starts_die_of_is_left() {
        let once = History::default().reading(4);
        assert!(once.allows(4));
        let often = once.reading(4).reading(4);
        assert!(!often.allows(4) && often.allows(3) && often.read().allows(4));
        assert_eq!(often.reading(3).readings, 1);
        let left = History::default().without_maps_until(7);
        assert!(!left.allows(7) && left.allows(8) && left.without_maps_until(2) == left);
        let room = tempfile::tempdir().expect("a folder");
        let sessions = Sessions::open(room.path()).expect("it is ours");
        sessions.keep_history(&left);
        assert_eq!(sessions.history(), left);
        fs::write(room.path().join(HISTORY), "{").expect("there is room");
        assert_eq!(sessions.history(), History::default());
    }
}
