//! How objects are asked for over a link: in which order, how much at once, and when again.
//!
//! Under way at a time is what the link carried lately in half a second and a round trip (a window as of BBR, Cardwell et
//! al. 2016: the measured rate times the time), so that a slow link is never filled for longer than that and what is
//! urgent waits no longer. Without the round trip a link of two seconds' delay would starve itself: half a second's worth
//! every two seconds is a quarter of the rate, and so on down. Where messages are lost, as much more is under way as it
//! takes for as much to come back.
//!
//! A link mostly keeps the order and loses nothing, as TCP does: what is late comes once a link that stands still goes on. So a
//! request is repeated only where one that was sent later is answered, or where nothing at all is for long while the neighbour is
//! heard. Where answers are overtaken, the link is one that loses messages, and what is late is repeated.

use crate::hash::ObjectHash;
use crate::wire::{MAX_PART, Message};
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::time::Duration;

/// What parts are made of, bytes: the smallest part but for an object's last.
const BLOCK: usize = 4096;
/// Time that the window covers beside a round trip.
const WINDOW_TIME: Duration = Duration::from_millis(500);
/// Time that a part should take on the link: a state that waits for one waits no longer.
const PART_TIME: Duration = Duration::from_millis(50);
/// The window before anything is known of a link, bytes: half a second of 256 kbit/s.
const FIRST_WINDOW: usize = 4 * BLOCK;
/// Largest window, bytes: what a neighbour may be asked for at once.
const LARGEST_WINDOW: usize = 4 << 20;
/// Bytes of objects that are here in part, per neighbour: a neighbour that begins all and ends none is asked no more.
const LARGEST_BEGUN: usize = 128 << 20;
/// How long an answer may take before anything is known of the link, and at the least and most afterwards.
const FIRST_PATIENCE: Duration = Duration::from_secs(2);
const LEAST_PATIENCE: Duration = Duration::from_millis(200);
const MOST_PATIENCE: Duration = Duration::from_secs(20);
/// How many times as long nothing at all may be answered, and how long at the least.
const UNANSWERED: u32 = 4;
const LEAST_UNANSWERED: Duration = Duration::from_secs(2);
/// Share of requests whose answer was overtaken from which on a link loses messages.
const LOSSY: f64 = 0.02;
/// A link on which nothing is heard for so long stands still: a neighbour says every second who it is ([`BEAT`](crate::node::BEAT)).
const STILL: Duration = Duration::from_millis(1500);
/// By how much the window is larger than what the link carried: without it a rate would never be found to be higher
/// (BBR's gain).
const PROBE: f64 = 1.25;
/// Weight of a request in the share that is answered, and the least share that is reckoned with.
const ANSWER_GAIN: f64 = 1.0 / 16.0;
const LEAST_ANSWERED: f64 = 0.1;
/// Time over which the rate is measured at the least.
const RATE_TIME: Duration = Duration::from_millis(50);

/// An object to be fetched.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ObjectRef {
    /// Which.
    pub hash: ObjectHash,
    /// Its size, bytes.
    pub size: u32,
}

/// What became of a part that came.
#[derive(Debug, PartialEq, Eq)]
pub enum PartOutcome {
    /// It was wanted, and more of the object is missing.
    More,
    /// The object is whole and what it should be.
    Whole(Vec<u8>),
    /// The object is whole and not what it is called. It is wanted no more.
    Wrong,
    /// Nobody wants it (any more), or it is here already.
    Unwanted,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum BlockState {
    Missing,
    Requested,
    Here,
}

/// An object of which some is here.
struct Begun {
    bytes: Vec<u8>,
    blocks: Vec<BlockState>,
    left: usize,
}

/// A request without an answer yet.
struct Request {
    /// Which of all that were sent.
    number: u64,
    hash: ObjectHash,
    first: usize,
    blocks: usize,
    sent: Duration,
}

/// What is fetched from one neighbour.
#[derive(Default)]
pub struct Fetch {
    /// What is wanted, in its order, and where in that order each is.
    queue: BTreeMap<usize, ObjectRef>,
    places: HashMap<ObjectHash, usize>,
    begun: BTreeMap<ObjectHash, Begun>,
    outstanding: Vec<Request>,
    /// How many requests were sent, and the last of them that was answered.
    sent: u64,
    last_answered: u64,
    pace: Pace,
    /// Bytes of parts that came, wanted or not.
    pub received: u64,
    /// Bytes of them that were here already or nobody wanted.
    pub useless: u64,
}

impl Fetch {
    /// What is wanted from now on, the most urgent first. What is here of objects that are still wanted stays.
    pub fn set_queue(&mut self, queue: Vec<ObjectRef>) {
        self.places = queue.iter().map(|want| want.hash).zip(0..).collect();
        self.begun.retain(|hash, _| self.places.contains_key(hash));
        self.outstanding.retain(|request| self.places.contains_key(&request.hash));
        self.queue = (0..).zip(queue).collect();
    }

    /// How many objects are wanted.
    pub fn queued(&self) -> usize {
        self.queue.len()
    }

    /// The measured rate, bytes a second.
    pub fn rate(&self) -> f64 {
        self.pace.rate
    }

    /// The link was lost: nothing is under way any more.
    pub fn lost(&mut self) {
        for request in std::mem::take(&mut self.outstanding) {
            self.release(&request);
        }
        self.pace = Pace::default();
    }

    /// The neighbour said something, whatever it is.
    pub fn note_message(&mut self, now: Duration) {
        self.pace.note_message(now);
    }

    /// Whether a request, or what answers it, was lost.
    fn is_lost(&self, request: &Request, now: Duration) -> bool {
        let waited = now.saturating_sub(request.sent);
        let is_unanswered = || waited > self.pace.patience_unanswered() && self.pace.is_unanswered(now);
        waited > self.pace.patience()
            && (self.is_overtaken(request) || self.pace.overtaken > LOSSY || is_unanswered())
    }

    /// Whether one that was sent later is answered.
    fn is_overtaken(&self, request: &Request) -> bool {
        request.number < self.last_answered
    }

    /// What to ask for now.
    pub fn requests(&mut self, now: Duration) -> Vec<Message> {
        let outstanding = std::mem::take(&mut self.outstanding);
        let (lost, kept): (Vec<_>, _) =
            outstanding.into_iter().partition(|request| self.is_lost(request, now));
        self.outstanding = kept;
        if !lost.is_empty() {
            let overtaken = lost.iter().filter(|request| self.is_overtaken(request)).count();
            self.pace.were_lost(now, overtaken, lost.len());
            lost.iter().for_each(|request| self.release(request));
        }
        let mut room = self.pace.window().saturating_sub(self.outstanding_bytes());
        let longest = self.pace.part() / BLOCK;
        let mut begun_bytes: usize = self.begun.values().map(|begun| begun.bytes.len()).sum();
        let mut asked = Vec::new();
        for want in self.queue.values() {
            if room == 0 {
                break;
            }
            if let Entry::Vacant(free) = self.begun.entry(want.hash) {
                let size = want.size as usize;
                if begun_bytes > 0 && begun_bytes + size > LARGEST_BEGUN {
                    break;
                }
                begun_bytes += size;
                let blocks = vec![BlockState::Missing; size.div_ceil(BLOCK).max(1)];
                free.insert(Begun { bytes: vec![0; size], left: blocks.len(), blocks });
            }
            let Some(begun) = self.begun.get_mut(&want.hash) else { continue };
            while room > 0 {
                let Some(first) = begun.blocks.iter().position(|block| *block == BlockState::Missing) else {
                    break;
                };
                let run = begun.blocks[first..]
                    .iter()
                    .take(longest)
                    .take_while(|block| **block == BlockState::Missing);
                let blocks = run.count();
                begun.blocks[first..first + blocks].fill(BlockState::Requested);
                let length = (begun.bytes.len() - first * BLOCK).min(blocks * BLOCK);
                self.sent += 1;
                let (number, hash) = (self.sent, want.hash);
                self.outstanding.push(Request { number, hash, first, blocks, sent: now });
                let (offset, length) = ((first * BLOCK) as u32, length as u32);
                asked.push(Message::Get { hash: want.hash, offset, length });
                room = room.saturating_sub(blocks * BLOCK);
            }
        }
        asked
    }

    /// Takes a part that came.
    pub fn handle_part(&mut self, now: Duration, hash: &ObjectHash, offset: u32, part: &[u8]) -> PartOutcome {
        self.received += part.len() as u64;
        let first = offset as usize / BLOCK;
        let matching = |request: &Request| request.hash == *hash && request.first == first;
        let answered = self.outstanding.iter().position(matching).map(|at| self.outstanding.swap_remove(at));
        let round_trip = answered.as_ref().map(|request| now.saturating_sub(request.sent));
        self.last_answered = answered.as_ref().map_or(0, |request| request.number).max(self.last_answered);
        self.pace.came(now, part.len(), round_trip, !self.outstanding.is_empty());
        let fits = |begun: &&mut Begun| {
            let end = offset as usize + part.len();
            let whole = end == begun.bytes.len() || part.len().is_multiple_of(BLOCK);
            (offset as usize).is_multiple_of(BLOCK) && end <= begun.bytes.len() && whole
        };
        let Some(begun) = self.begun.get_mut(hash).filter(fits) else {
            self.useless += part.len() as u64;
            return PartOutcome::Unwanted;
        };
        begun.bytes[offset as usize..offset as usize + part.len()].copy_from_slice(part);
        let blocks = part.len().div_ceil(BLOCK).max(1);
        let mut is_new = false;
        for block in begun.blocks.iter_mut().skip(first).take(blocks) {
            if *block != BlockState::Here {
                is_new = true;
                begun.left -= 1;
            }
            *block = BlockState::Here;
        }
        if let Some(request) = answered.filter(|request| request.blocks > blocks) {
            // It sent less than was asked for.
            self.release(&request);
        }
        if !is_new {
            self.useless += part.len() as u64;
            return PartOutcome::Unwanted;
        }
        if self.begun.get(hash).is_some_and(|begun| begun.left > 0) {
            return PartOutcome::More;
        }
        self.remove_queued(hash);
        match self.begun.remove(hash) {
            Some(begun) if ObjectHash::of(&begun.bytes) == *hash => PartOutcome::Whole(begun.bytes),
            _ => PartOutcome::Wrong,
        }
    }

    /// An object is not to be had from this neighbour; whether it was wanted.
    pub fn drop_object(&mut self, hash: &ObjectHash) -> bool {
        self.begun.remove(hash);
        self.remove_queued(hash)
    }

    fn remove_queued(&mut self, hash: &ObjectHash) -> bool {
        self.outstanding.retain(|request| request.hash != *hash);
        let place = self.places.remove(hash);
        place.is_some_and(|place| self.queue.remove(&place).is_some())
    }

    /// What a request asked for and is not here is missing again.
    fn release(&mut self, request: &Request) {
        let Some(begun) = self.begun.get_mut(&request.hash) else { return };
        let blocks = begun.blocks.iter_mut().skip(request.first).take(request.blocks);
        blocks
            .filter(|block| **block == BlockState::Requested)
            .for_each(|block| *block = BlockState::Missing);
    }

    fn outstanding_bytes(&self) -> usize {
        self.outstanding.iter().map(|request| request.blocks * BLOCK).sum()
    }
}

/// What is known of how fast a link is.
struct Pace {
    /// Bytes a second.
    rate: f64,
    /// Shortest round trip of a request.
    least: Option<Duration>,
    /// Mean round trip and its mean deviation, seconds (Jacobson 1988).
    smoothed: Option<(f64, f64)>,
    /// Share of requests that are answered in time.
    answered: f64,
    /// Share of them whose answer does not come though that of a later one does.
    overtaken: f64,
    /// When the last answer came, patience grew, or the link went on after it stood still.
    answer: Duration,
    /// When the neighbour was heard last.
    received_at: Duration,
    /// How often patience was doubled since the last answer.
    backoff: u32,
    since: Option<Duration>,
    bytes: usize,
    /// Whether something was under way all the time since.
    busy: bool,
}

impl Default for Pace {
    fn default() -> Self {
        let (least, smoothed, since) = (None, None, None);
        let (answer, received_at) = Default::default();
        let (rate, answered, overtaken) = (0.0, 1.0, 0.0);
        let (backoff, bytes, busy) = (0, 0, true);
        Self { rate, least, smoothed, answered, overtaken, answer, received_at, backoff, since, bytes, busy }
    }
}

impl Pace {
    fn came(&mut self, now: Duration, bytes: usize, round_trip: Option<Duration>, busy: bool) {
        if let Some(round_trip) = round_trip {
            (self.backoff, self.answer) = (0, now);
            self.answered += (1.0 - self.answered) * ANSWER_GAIN;
            self.overtaken -= self.overtaken * ANSWER_GAIN;
            self.least = Some(self.least.map_or(round_trip, |least| least.min(round_trip)));
            let seconds = round_trip.as_secs_f64();
            self.smoothed = Some(match self.smoothed {
                None => (seconds, seconds / 2.0),
                Some((mean, deviation)) => {
                    (mean + (seconds - mean) / 8.0, deviation + ((seconds - mean).abs() - deviation) / 4.0)
                }
            });
        }
        self.bytes += bytes;
        // Time passes from the request on for the first part that comes.
        let since = *self.since.get_or_insert(now.saturating_sub(round_trip.unwrap_or_default()));
        self.busy &= busy;
        let passed = now.saturating_sub(since);
        if passed < RATE_TIME.max(self.least.unwrap_or_default()) {
            return;
        }
        let found = self.bytes as f64 / passed.as_secs_f64();
        if found > self.rate {
            self.rate = found;
        } else if self.busy {
            // Idle time says nothing about the link.
            self.rate += 0.2 * (found - self.rate);
        }
        (self.since, self.bytes, self.busy) = (busy.then_some(now), 0, true);
    }

    fn window(&self) -> usize {
        let Some(least) = self.least else { return FIRST_WINDOW };
        let bytes = PROBE * self.rate * (WINDOW_TIME + least).as_secs_f64() / self.answered;
        (bytes as usize).clamp(2 * self.part(), LARGEST_WINDOW)
    }

    fn part(&self) -> usize {
        let blocks = (self.rate * PART_TIME.as_secs_f64()) as usize / BLOCK;
        blocks.clamp(1, MAX_PART / BLOCK) * BLOCK
    }

    fn patience(&self) -> Duration {
        let known = self.smoothed.map_or(FIRST_PATIENCE, |(mean, deviation)| {
            Duration::from_secs_f64(mean + 4.0 * deviation) + LEAST_PATIENCE
        });
        (known * (1 << self.backoff)).min(MOST_PATIENCE)
    }

    /// How long nothing at all may be answered.
    fn patience_unanswered(&self) -> Duration {
        (self.patience() * UNANSWERED).max(LEAST_UNANSWERED).min(MOST_PATIENCE)
    }

    /// Whether nothing at all was answered for long, by a neighbour that is heard.
    fn is_unanswered(&self, now: Duration) -> bool {
        let is_still = now.saturating_sub(self.received_at) > STILL;
        !is_still && now.saturating_sub(self.answer) > self.patience_unanswered()
    }

    /// The neighbour is heard. Time in which the link stood still does not count: what was under way comes now.
    fn note_message(&mut self, now: Duration) {
        let silent = now.saturating_sub(self.received_at);
        if silent > STILL {
            (self.backoff, self.answer) = (0, (self.answer + silent).min(now));
        }
        self.received_at = now;
    }

    /// So many requests were lost, so many of them overtaken. Where nothing at all is answered, one waits twice as long.
    fn were_lost(&mut self, now: Duration, overtaken: usize, count: usize) {
        let kept = |count: usize| (1.0 - ANSWER_GAIN).powi(count.min(100) as i32);
        self.overtaken = 1.0 - (1.0 - self.overtaken) * kept(overtaken);
        let share = self.answered * kept(count);
        self.answered = share.max(LEAST_ANSWERED);
        if now.saturating_sub(self.answer) > self.patience() {
            (self.backoff, self.answer) = ((self.backoff + 1).min(4), now);
        }
    }
}
