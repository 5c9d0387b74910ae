//! The growing maps of a run: written in a thread of its own (`writing`), as the agent says what happened, so that a
//! killed run leaves them and the tracker does not wait for the disk.

mod writing;

use anyhow::{Context, Result, anyhow};
use map::{AgentInfo, FramePose, Map, MapDelta};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use writing::Writing;

/// Frames that may wait to be written: two seconds of video. A tracker that is so much faster than the disk waits.
const WAITING: usize = 64;

/// What goes to the thread.
enum Message {
    /// The map of a fragment is begun in this file, in place of what was written of it.
    Begin(usize, PathBuf, Box<AgentInfo>),
    /// The map of a fragment has changed: deltas and new frames.
    Grown(usize, Vec<MapDelta>, Vec<FramePose>),
    /// A part of what follows in `Grown`: the file does not get its name by it.
    Piece(usize, Vec<MapDelta>, Vec<FramePose>),
    /// Everything so far is to be with the system, and then this to be answered.
    Flush(Sender<()>),
}

/// The tracker's end: hands on what is new.
#[derive(Default)]
pub struct LiveMapWriter {
    /// Whether what finds no room on the disk waits in memory until there is some; else it ends the run.
    waits: bool,
    /// Whether anything waits for room.
    waits_for_room: Arc<AtomicBool>,
    messages: Option<SyncSender<Message>>,
    thread: Option<JoinHandle<Result<()>>>,
    /// Frames handed on of each fragment's map.
    handed: BTreeMap<usize, usize>,
}

impl LiveMapWriter {
    /// Says whether what finds no room on the disk waits in memory until there is some, before anything is handed on.
    pub fn wait_for_room(&mut self, waits: bool) {
        self.waits = waits;
    }

    /// Whether anything waits in memory for room on the disk.
    pub fn waits_for_room(&self) -> bool {
        self.waits_for_room.load(Ordering::Relaxed)
    }

    /// Hands on what was said of the map of a fragment, and its frames since the last call. `file` says where a map
    /// that is begun is written to, and whose it is.
    ///
    /// # Errors
    /// When a file could not be written, now or before.
    pub fn grow(
        &mut self,
        fragment: usize,
        map: &Map,
        deltas: Vec<MapDelta>,
        file: impl FnOnce() -> Result<(PathBuf, AgentInfo)>,
    ) -> Result<()> {
        if deltas.iter().any(|delta| delta.sequence == 0) {
            let (path, about) = file()?;
            self.send(Message::Begin(fragment, path, Box::new(about)))?;
            self.handed.insert(fragment, 0);
        }
        let Some(handed) = self.handed.get_mut(&fragment) else { return Ok(()) };
        // A map that was given up has no frames, and another one begins with a delta of its own.
        let frames = map.frames.get(*handed..).unwrap_or_default().to_vec();
        *handed = map.frames.len();
        if deltas.is_empty() && frames.is_empty() {
            Ok(())
        } else {
            self.send(Message::Grown(fragment, deltas, frames))
        }
    }

    /// Waits until everything so far is with the system.
    ///
    /// # Errors
    /// When a file could not be written.
    pub fn flush(&mut self) -> Result<()> {
        if self.thread.is_none() {
            return Ok(());
        }
        let (answer, answered) = channel();
        self.send(Message::Flush(answer))?;
        match answered.recv() {
            Ok(()) => Ok(()),
            Err(_) => self.end(),
        }
    }

    /// Ends the thread, when it has written all it was given.
    ///
    /// # Errors
    /// When a file could not be written.
    pub fn end(&mut self) -> Result<()> {
        self.messages = None;
        self.handed.clear();
        let Some(thread) = self.thread.take() else { return Ok(()) };
        let written = thread.join().map_err(|panic| {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let why = text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("no reason was given");
            anyhow!("internal error in writing the map, please report it: {why}")
        });
        let hint = "hint: what was written before is whole: `loopbox export --mcap` mends the file";
        written?.with_context(|| format!("the run was ended, its map could not be written on\n{hint}"))
    }

    fn send(&mut self, message: Message) -> Result<()> {
        if self.thread.is_none() {
            let (messages, waiting) = sync_channel(WAITING);
            let writing = Writing::new(self.waits, Arc::clone(&self.waits_for_room));
            let thread = std::thread::Builder::new().name("map".into()).spawn(move || writing.run(&waiting));
            self.thread = Some(thread.context("cannot start a thread")?);
            self.messages = Some(messages);
        }
        // The thread goes away before its sender only when it could not write.
        match self.messages.as_ref().map(|messages| messages.send(message)) {
            Some(Ok(())) => Ok(()),
            _ => self.end(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::{GrayImage, Pinhole, Se3, Sim3};
    use map::{AgentId, Keyframe, KeyframeId, SemiDense, Settled};
    use std::path::Path;
    use std::sync::Arc;

    fn keyframe(id: u32) -> Keyframe {
        let image = Arc::new(GrayImage::filled(8, 6, 90));
        Keyframe::of_image(KeyframeId(id), f64::from(id), u64::from(id), Sim3::identity(), image)
    }

    /// A map that grows by what is said of it, and its file.
    struct Case {
        map: Map,
        writer: LiveMapWriter,
        path: PathBuf,
        next_sequence: u64,
    }

    impl Case {
        fn new(path: &Path) -> Self {
            let camera = Pinhole { width: 8, height: 6, fx: 8.0, fy: 8.0, cx: 3.5, cy: 2.5 };
            let map = Map::of(AgentInfo::new("one", camera));
            Self { map, writer: LiveMapWriter::default(), path: path.to_owned(), next_sequence: 0 }
        }

        fn apply(&mut self, delta: MapDelta) -> Result<()> {
            let delta = MapDelta { sequence: self.next_sequence, ..delta };
            self.next_sequence += 1;
            self.map.take_in(delta.clone());
            self.grow(vec![delta])
        }

        fn grow(&mut self, deltas: Vec<MapDelta>) -> Result<()> {
            let about = self.map.agents[&AgentId::default()].clone();
            let path = self.path.clone();
            self.writer.grow(0, &self.map, deltas, || Ok((path, about)))?;
            self.writer.flush()
        }

        fn add_frame(&mut self) {
            let count = self.map.frames.len() as u64;
            self.map.frames.push(FramePose {
                timestamp: count as f64,
                frame_index: count,
                reference: KeyframeId(0),
                keyframe_from_frame: Se3::identity(),
            });
        }

        fn size(&self) -> u64 {
            std::fs::metadata(&self.path).map_or(0, |about| about.len())
        }
    }

    fn added(ids: impl IntoIterator<Item = u32>) -> MapDelta {
        MapDelta { added: ids.into_iter().map(keyframe).collect(), ..MapDelta::default() }
    }

    #[test]
    fn the_file_gets_the_deltas_and_nothing_else() {
        let room = tempfile::tempdir().expect("a folder");
        let mut case = Case::new(&room.path().join("map.mcap"));
        case.grow(Vec::new()).expect("there is nothing to write");
        assert_eq!(case.size(), 0, "there is no file before there is a map");
        case.add_frame();
        case.apply(added([0, 1])).expect("there is room");
        let size = case.size();
        assert!(size > 0);
        for _ in 0..3 {
            case.grow(Vec::new()).expect("there is room");
        }
        assert_eq!(case.size(), size, "a camera that stands still writes nothing");
        case.add_frame();
        case.grow(Vec::new()).expect("there is room");
        let semi_dense =
            SemiDense { pixel: vec![7].into(), inverse_depth: vec![0.5].into(), variance: vec![0.01].into() };
        let settled =
            vec![Settled { keyframe: KeyframeId(0), semi_dense: semi_dense.into(), points: Vec::new() }];
        case.apply(MapDelta { settled, ..added([2]) }).expect("there is room");
        assert!(map::load_map(&case.path).expect("it loads").map == case.map);
        // The map is given up: another one takes its place.
        (case.map.keyframes, case.map.frames, case.next_sequence) = Default::default();
        case.grow(Vec::new()).expect("there is room");
        case.add_frame();
        case.apply(added([0])).expect("there is room");
        assert!(map::load_map(&case.path).expect("it loads").map == case.map);
        case.writer.end().expect("all is written");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_that_cannot_be_written_is_reported_at_the_next_call() {
        let mut case = Case::new(Path::new("/dev/full"));
        case.add_frame();
        let error = case.apply(added([0])).expect_err("there is no room");
        assert!(format!("{error:#}").contains("/dev/full"), "{error:#}");
        assert!(format!("{error:#}").contains("the run was ended"), "{error:#}");
    }
}
