//! The thread that writes growing maps.
//!
//! A file gets its name once all that was said of the map at first is on the disk: a run that goes on in a map of hours
//! says all of it at once, and whoever finds `map.mcap` finds no less than that map.

use super::Message;
use crate::swapping::free_bytes;
use anyhow::{Context, Result};
use map::{AgentInfo, FramePose, Keyframe, MapDelta, MapWriter, Settled};
use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// Frames between keyframes are written so often, and all that is written is brought to the disk: a killed run and a
/// power cut lose no more.
const FLUSH_INTERVAL: Duration = Duration::from_secs(1);
/// Keyframes that are written at a time, each time if there is room for them: a run that goes on in a map says all of it at
/// once.
const TOGETHER: usize = 8;
/// How often room is looked for where there was none.
const LOOK: Duration = Duration::from_millis(500);
/// Bytes that stay free beside what is to be written, so that no record is torn by a full disk.
const SPARE: u64 = 4 << 20;
/// Bytes of a pixel's depth in a file: where, inverse depth and variance.
const DEPTH_BYTES: u64 = 12;
/// Bytes of a point in a file, with the observations of some keyframes.
const POINT_BYTES: u64 = 400;
/// Bytes of a frame or of a change of pose or edge in a file.
const POSE_BYTES: u64 = 160;

/// What the thread holds.
pub struct Writing {
    growths: BTreeMap<usize, Growth>,
    /// Whether what finds no room waits for it.
    waits: bool,
    /// What waits for room, in order.
    pending: VecDeque<Message>,
    waits_for_room: Arc<AtomicBool>,
}

impl Writing {
    /// Nothing is written yet; with `waits`, what finds no room stays in memory until there is some, and `waits_for_room` says so.
    pub fn new(waits: bool, waits_for_room: Arc<AtomicBool>) -> Self {
        Self { growths: BTreeMap::new(), waits, pending: VecDeque::new(), waits_for_room }
    }

    /// Writes until nobody sends any more.
    pub fn run(mut self, messages: &Receiver<Message>) -> Result<()> {
        loop {
            match self.next(messages) {
                // Nobody is to wait for a disk that is full.
                Ok(Message::Flush(answer)) if !self.pending.is_empty() => drop(answer.send(())),
                Ok(message) => self.pending.push_back(message),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
            self.write_what_has_room()?;
            self.growths.values_mut().try_for_each(Growth::sync_when_due)?;
        }
        // The last chance: what was spared may be enough.
        while let Some(message) = self.pending.pop_front() {
            self.write(message)?;
        }
        self.waits_for_room.store(false, Ordering::Relaxed);
        self.growths.values_mut().try_for_each(|growth| {
            growth.flush()?;
            growth.sync()
        })
    }

    fn next(&self, messages: &Receiver<Message>) -> Result<Message, RecvTimeoutError> {
        let is_synced = self.growths.values().all(|growth| growth.unsynced_since.is_none());
        match (self.pending.is_empty(), is_synced) {
            (true, true) => messages.recv().map_err(|_| RecvTimeoutError::Disconnected),
            (true, false) => messages.recv_timeout(FLUSH_INTERVAL),
            (false, _) => messages.recv_timeout(LOOK),
        }
    }

    fn write_what_has_room(&mut self) -> Result<()> {
        while let Some(mut message) = self.pending.pop_front() {
            if !self.waits {
                self.write(message)?;
                continue;
            }
            let piece = message.split_off();
            if !self.has_room(piece.as_ref().unwrap_or(&message)) {
                message.put_back(piece);
                self.pending.push_front(message);
                break;
            }
            match piece {
                Some(piece) => {
                    self.write(piece)?;
                    self.pending.push_front(message);
                }
                None => self.write(message)?,
            }
        }
        self.waits_for_room.store(!self.pending.is_empty(), Ordering::Relaxed);
        Ok(())
    }

    /// Whether the disk has room for a message.
    fn has_room(&self, message: &Message) -> bool {
        let (path, bytes) = match message {
            Message::Begin(_, path, _) => (Some(path), 0),
            Message::Grown(fragment, deltas, frames) | Message::Piece(fragment, deltas, frames) => (
                self.growths.get(fragment).map(|growth| &growth.path),
                deltas.iter().map(size).sum::<u64>() + frames.len() as u64 * POSE_BYTES,
            ),
            Message::Flush(_) => (None, 0),
        };
        let free = path.and_then(|path| path.parent()).and_then(free_bytes);
        // A file system that does not say has room until it has none.
        free.is_none_or(|free| free >= bytes + SPARE)
    }

    fn write(&mut self, message: Message) -> Result<()> {
        match message {
            Message::Begin(fragment, path, about) => {
                self.growths.insert(fragment, Growth::begin(path, &about)?);
            }
            Message::Grown(fragment, deltas, frames) => {
                if let Some(growth) = self.growths.get_mut(&fragment) {
                    growth.grow(&deltas, frames)?;
                }
            }
            Message::Piece(fragment, deltas, _) => {
                if let Some(growth) = self.growths.get_mut(&fragment) {
                    growth.append(&deltas)?;
                }
            }
            Message::Flush(answer) => {
                self.growths.values_mut().try_for_each(Growth::flush)?;
                // Whoever asked may have given up.
                let _ = answer.send(());
            }
        }
        Ok(())
    }
}

impl Message {
    /// Takes some keyframes off a delta of many, to be written before the rest.
    fn split_off(&mut self) -> Option<Self> {
        let Self::Grown(fragment, deltas, _) = self else { return None };
        let first = deltas.first_mut().filter(|delta| delta.added.len() > TOGETHER)?;
        let added = first.added.drain(..TOGETHER).collect();
        Some(Self::Piece(*fragment, vec![MapDelta { added, ..MapDelta::default() }], Vec::new()))
    }

    /// Puts back what was taken off.
    fn put_back(&mut self, piece: Option<Self>) {
        if let (Self::Grown(_, deltas, _), Some(Self::Piece(_, mut pieces, _))) = (self, piece)
            && let (Some(first), Some(piece)) = (deltas.first_mut(), pieces.first_mut())
        {
            piece.added.append(&mut first.added);
            std::mem::swap(&mut first.added, &mut piece.added);
        }
    }
}

/// Bytes that a delta may take in a file, at most: images are compressed there.
fn size(delta: &MapDelta) -> u64 {
    let depth = |pixels: usize, points: usize| pixels as u64 * DEPTH_BYTES + points as u64 * POINT_BYTES;
    let keyframe = |k: &Keyframe| {
        let features = k.features.as_ref().map_or(0, |features| features.len());
        let color = k.color.as_ref().map_or(0, |color| color.jpeg.len());
        (k.image.data().len() + color + features) as u64 + depth(k.semi_dense.len(), k.points.len())
    };
    let settled = |s: &Settled| depth(s.semi_dense.len(), s.points.len());
    let poses = delta.moved.len() + delta.edges.as_ref().map_or(0, Vec::len);
    delta.added.iter().map(keyframe).sum::<u64>()
        + delta.settled.iter().map(settled).sum::<u64>()
        + delta.described.iter().map(|described| described.features.len() as u64).sum::<u64>()
        + poses as u64 * POSE_BYTES
}

/// The map of one fragment.
struct Growth {
    writer: MapWriter,
    /// What the file is to be called, or is.
    path: PathBuf,
    /// Whether it is called so.
    is_placed: bool,
    /// Whether it is a file, and no pipe or device.
    is_file: bool,
    /// Frames that are not written yet.
    frames: Vec<FramePose>,
    flushed: Instant,
    /// Since when there is something that is not on the disk yet.
    unsynced_since: Option<Instant>,
}

impl Growth {
    fn begin(path: PathBuf, about: &AgentInfo) -> Result<Self> {
        let is_file = fs::metadata(&path).map_or(true, |found| found.is_file());
        let writer = MapWriter::create(if is_file { temporary_path(&path) } else { path.clone() }, about)?;
        let (frames, flushed) = (Vec::new(), Instant::now());
        Ok(Self { writer, path, is_placed: !is_file, is_file, frames, flushed, unsynced_since: None })
    }

    fn grow(&mut self, deltas: &[MapDelta], frames: Vec<FramePose>) -> Result<()> {
        self.frames.extend(frames);
        self.append(deltas)?;
        if !deltas.is_empty() || self.flushed.elapsed() >= FLUSH_INTERVAL { self.flush() } else { Ok(()) }
    }

    fn append(&mut self, deltas: &[MapDelta]) -> Result<()> {
        deltas.iter().try_for_each(|delta| self.writer.append(delta, &[]))?;
        Ok(self.writer.flush()?)
    }

    fn flush(&mut self) -> Result<()> {
        self.writer.append(&MapDelta::default(), &self.frames)?;
        self.frames.clear();
        self.flushed = Instant::now();
        self.writer.flush()?;
        self.unsynced_since.get_or_insert(self.flushed);
        if !self.is_placed { self.place() } else { Ok(()) }
    }

    /// Gives the file its name, with all that is in it on the disk.
    fn place(&mut self) -> Result<()> {
        self.sync()?;
        self.writer.rename(&self.path)?;
        self.is_placed = true;
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let synced = File::open(folder.unwrap_or(Path::new("."))).and_then(|folder| folder.sync_all());
        synced.with_context(|| format!("{}: cannot be written", self.path.display()))
    }

    fn sync_when_due(&mut self) -> Result<()> {
        let is_due = self.unsynced_since.is_some_and(|since| since.elapsed() >= FLUSH_INTERVAL);
        if is_due { self.sync() } else { Ok(()) }
    }

    fn sync(&mut self) -> Result<()> {
        match self.unsynced_since.take() {
            Some(_) if self.is_file => Ok(self.writer.sync()?),
            _ => Ok(()),
        }
    }
}

impl Drop for Growth {
    fn drop(&mut self) {
        if !self.is_placed {
            // Nothing of the map is in it.
            let _ = fs::remove_file(temporary_path(&self.path));
        }
    }
}

/// What a file is called until it has its name.
fn temporary_path(path: &Path) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".tmp");
    path.with_file_name(name)
}
