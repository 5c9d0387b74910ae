//! Calibration watched: a page with what the camera sees, where the board was seen, and which views are still missing.

use super::collect::{CollectProgress, Shot};
use anyhow::Result;
use calib::coach::{CELLS, Coverage, ENOUGH_VIEWS};
use calib::{Board, SolverParams, View};
use serde::{Deserialize, Serialize};
use serde_json::json;
use sources::Stop;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use view::report::page::Template;
use view::script;
use view::watch::Picture;
use view::watch::web::{Address, FEED_SCRIPTS, Message, PageSession, Server, picture_message};

/// How often it is looked whether the user has seen enough.
const LOOK: Duration = Duration::from_millis(50);
/// Marks of corners in the live image: of a view that was kept, of one like those before, of one that does not count.
const KEPT: u8 = 2;
const SIMILAR: u8 = 1;
const USELESS: u8 = 0;

const TEMPLATE: Template = Template {
    body: include_str!("assets/coach.html"),
    style: include_str!("assets/coach.css"),
    policy: "; connect-src 'self'",
    scene: false,
    scripts: &[FEED_SCRIPTS[0], FEED_SCRIPTS[1], script!("assets/coach.js")],
};

/// What the page's script starts from.
#[derive(Serialize)]
struct Data {
    /// Columns and rows of the cells that coverage is counted in.
    cells: [usize; 2],
    enough_views: usize,
    /// With fewer there is no calibration.
    least_views: usize,
    /// All that may be missing.
    wishes: Vec<String>,
}

/// Where the calibration stands.
#[derive(Clone, Default, Serialize)]
struct Status {
    /// `collecting`, `solving`, `done` or `failed`.
    state: &'static str,
    /// Images looked at.
    images: usize,
    /// Views that count.
    views: usize,
    /// Share of the image's cells that corners were found in, 0–1.
    share: f64,
    /// Corners found in each cell, row by row.
    cells: Vec<usize>,
    /// Size of the images, pixels.
    size: [usize; 2],
    /// What to do next, the weightiest first.
    missing: Vec<String>,
    /// What the newest image is good for.
    verdict: String,
    /// The result, or why there is none.
    result: String,
    /// Whether the program waits until the user has seen enough.
    waits: bool,
}

/// What the calibration and its pages share.
#[derive(Default)]
struct Desk {
    state: Mutex<State>,
    /// The user has enough.
    enough: AtomicBool,
    over: AtomicBool,
}

#[derive(Default)]
struct State {
    /// Grows with every change.
    tick: u64,
    status: Status,
    picture: Option<Arc<Picture>>,
    /// Corners of each view that counts, x and y by turns as shares of the image.
    views: Vec<Vec<f64>>,
}

impl Desk {
    fn state(&self) -> MutexGuard<'_, State> {
        // Every section leaves it whole, so a panic elsewhere does not spoil it.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.state();
        state.tick += 1;
        change(&mut state);
    }
}

/// How a calibration is watched; without an address nobody watches.
pub struct Coaching(Option<Inner>);

struct Inner {
    desk: Arc<Desk>,
    server: Server,
    /// Whether a camera is watched: somebody stands before it, and sees the end.
    live: bool,
}

impl Coaching {
    /// Serves the page; [`url`](Self::url) says where.
    ///
    /// # Errors
    /// When the address cannot be listened at.
    pub fn start(address: Option<Address>, board: &Board, live: bool) -> Result<Self> {
        let Some(address) = address else { return Ok(Self(None)) };
        let nothing = Coverage::default();
        let status = Status { state: "collecting", missing: nothing.advice(), ..Status::default() };
        // The number of views is shown by itself.
        let wishes =
            nothing.advice().into_iter().filter(|line| !line.starts_with("take more views")).collect();
        let least_views = SolverParams::default().min_views;
        let data = Data { cells: [CELLS.0, CELLS.1], enough_views: ENOUGH_VIEWS, least_views, wishes };
        let page = TEMPLATE.filled(&format!("Calibration from {board}"), &data)?;
        let desk = Arc::new(Desk::default());
        desk.change(|state| state.status = status);
        let of_pages = Arc::clone(&desk);
        let server = Server::serve(address, page, move || {
            Box::new(Visitor { desk: Arc::clone(&of_pages), tick: 0, views: 0, picture: None })
        })?;
        Ok(Self(Some(Inner { desk, server, live })))
    }

    /// Where the page is, if there is one.
    pub fn url(&self) -> Option<String> {
        self.0.as_ref().map(|inner| inner.server.url().to_owned())
    }

    /// Shows what was seen so far.
    pub fn show(&self, seen: &CollectProgress) {
        let Some(inner) = &self.0 else { return };
        let Some(shot) = seen.newest else { return };
        let picture = Arc::new(marked(shot, seen));
        inner.desk.change(|state| {
            let status = &mut state.status;
            (status.images, status.views, status.share) =
                (seen.given, seen.views.len(), seen.coverage.share());
            (status.cells, status.missing) = (seen.coverage.cells.clone(), seen.coverage.advice());
            status.size = [shot.image.width(), shot.image.height()];
            status.verdict = verdict(shot, seen.kept);
            state.picture = Some(picture);
            let size = status.size;
            state.views.extend(seen.views.iter().skip(state.views.len()).map(|view| places(view, size)));
        });
    }

    /// Whether the user has enough.
    pub fn has_enough(&self) -> bool {
        self.0.as_ref().is_some_and(|inner| inner.desk.enough.load(Ordering::Relaxed))
    }

    /// Says that no more images are taken.
    pub fn solving(&self) {
        if let Some(inner) = &self.0 {
            // What is pressed from now on is another wish.
            inner.desk.enough.store(false, Ordering::Relaxed);
            inner.desk.change(|state| state.status.state = "solving");
        }
    }

    /// Shows the result, or why there is none. That of a camera stays on the page when the program has ended; for one of
    /// files, which came sooner than anybody could open the page, is waited for until the user has seen enough; `waiting` is
    /// told where the page is.
    pub fn end(self, result: Result<&str, &str>, stop: &Stop, waiting: impl FnOnce(&str)) {
        let Some(inner) = self.0 else { return };
        let waits = result.is_ok() && !inner.live && !stop.requested();
        inner.desk.change(|state| {
            state.status.state = if result.is_ok() { "done" } else { "failed" };
            state.status.result = result.unwrap_or_else(|reason| reason).to_owned();
            state.status.waits = waits;
        });
        if waits {
            waiting(inner.server.url());
            while !stop.requested() && !inner.desk.enough.load(Ordering::Relaxed) {
                std::thread::sleep(LOOK);
            }
            inner.desk.change(|state| state.status.waits = false);
        }
        inner.desk.over.store(true, Ordering::Release);
        inner.server.wait_for_clients();
    }
}

/// One page.
struct Visitor {
    desk: Arc<Desk>,
    tick: u64,
    views: usize,
    picture: Option<Arc<Picture>>,
}

/// What the page says.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case", tag = "command")]
enum Command {
    /// The user has enough: of images, or of the result.
    Finish,
}

impl PageSession for Visitor {
    fn is_over(&self) -> bool {
        self.desk.over.load(Ordering::Acquire)
    }

    fn next_messages(&mut self) -> (Vec<Message>, bool) {
        let state = self.desk.state();
        if state.tick == self.tick {
            return (Vec::new(), false);
        }
        self.tick = state.tick;
        let mut texts = vec![json!({ "kind": "status", "status": state.status })];
        if self.views < state.views.len() {
            texts.push(json!({ "kind": "views", "from": self.views, "views": state.views[self.views..] }));
            self.views = state.views.len();
        }
        let same = |a: &Arc<Picture>| self.picture.as_ref().is_some_and(|b| Arc::ptr_eq(a, b));
        let picture = state.picture.clone().filter(|picture| !same(picture));
        drop(state);
        let mut messages: Vec<Message> = texts.iter().map(|text| Message::text(text.to_string())).collect();
        if let Some(picture) = picture {
            messages.push(picture_message(&picture));
            self.picture = Some(picture);
        }
        (messages, false)
    }

    fn receive(&mut self, text: &str) {
        if let Ok(Command::Finish) = serde_json::from_str(text) {
            self.desk.enough.store(true, Ordering::Relaxed);
        }
    }
}

/// The image with its corners marked by what it is good for.
fn marked(shot: &Shot, seen: &CollectProgress) -> Picture {
    let mut picture = Picture::new(seen.given as u64, 0.0, &shot.image);
    let shrink = picture.width as f64 / shot.image.width().max(1) as f64;
    let place = |v: f64| ((v + 0.5) * shrink - 0.5).round().clamp(0.0, f64::from(u16::MAX)) as u16;
    picture.pixels =
        shot.corners.iter().map(|corner| [place(corner.pixel.x), place(corner.pixel.y)]).collect();
    let mark = match (seen.kept, &shot.problem) {
        (true, _) => KEPT,
        (false, None) => SIMILAR,
        (false, Some(_)) => USELESS,
    };
    picture.codes = vec![mark; picture.pixels.len()];
    picture
}

fn verdict(shot: &Shot, kept: bool) -> String {
    match &shot.problem {
        _ if kept => "taken".into(),
        Some(problem) => problem.clone(),
        None => "like one taken before: move or tilt the board".into(),
    }
}

/// Where a view's corners are, as shares of the image; four figures are a tenth of a pixel.
fn places(view: &View, [width, height]: [usize; 2]) -> Vec<f64> {
    let share = |v: f64, side: usize| ((v + 0.5) / side.max(1) as f64 * 1e4).round() / 1e4;
    view.corners.iter().flat_map(|c| [share(c.pixel.x, width), share(c.pixel.y, height)]).collect()
}
