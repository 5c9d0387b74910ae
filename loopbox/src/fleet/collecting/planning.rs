//! What is worth fetching next: decided before every step, and whenever something comes while pairs are looked at. What an agent
//! is asked for by which its place is to be seen takes some rounds, and none of them waits for others' pairs.

use super::merger::Merger;
use super::step::Step;
use crate::fleet::components::Components;
use crate::fleet::prefetch::{Plan, Prefetcher};
use crate::fleet::waiting::Waits;
use map::Identity;
use place_recog::Vocabulary;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// How long it is looked for what to fetch before that is fetched.
const PLANNING: Duration = Duration::from_millis(200);
/// How often it is looked while pairs are, if nothing comes.
const LOOK: Duration = Duration::from_millis(100);

/// Decides what is fetched.
pub(super) struct Planner {
    /// What is worth fetching of every map.
    pub prefetcher: Prefetcher,
    /// How long agents waited for their places.
    pub waits: Waits,
}

impl Planner {
    /// Of nobody yet.
    pub fn new(vocabulary: Arc<Vocabulary>) -> Self {
        Self { prefetcher: Prefetcher::new(vocabulary), waits: Waits::default() }
    }

    /// Has fetched what is worth fetching next.
    pub fn plan(&mut self, step: &Step, components: &Components) -> Plan {
        let begun = Instant::now();
        let mut plan = self.plan_some(step, components, &BTreeSet::new());
        while plan.is_cut && plan.ready.is_none() && begun.elapsed() < PLANNING {
            plan = self.plan_some(step, components, &BTreeSet::new());
        }
        plan
    }

    /// Does `work`, which looks at some pairs, and beside it has fetched what is worth fetching next, where nobody is given way
    /// to. `work` is told whether something came meanwhile that is more urgent than agents which have their places.
    pub fn meanwhile<T>(
        &mut self,
        step: &Step,
        components: &Components,
        merger: &Merger,
        pairs: &BTreeSet<[Identity; 2]>,
        work: impl FnOnce(&(dyn Fn() -> bool + Sync)) -> T,
    ) -> T {
        let service = step.service;
        let mut seen = service.arrivals();
        if !merger.is_alone() {
            return work(&|| service.arrivals() != seen);
        }
        let is_ready = AtomicBool::new(false);
        let plan = |ends: &AtomicBool| {
            let mut is_cut = false;
            while !ends.load(Ordering::SeqCst) {
                if !is_cut {
                    seen = service.wait_for_arrivals(seen, LOOK, ends);
                }
                if ends.load(Ordering::SeqCst) {
                    return;
                }
                let plan = self.plan_some(&step.renewed(), components, pairs);
                is_cut = plan.is_cut;
                let comes = plan.ready.is_some() || self.waits.is_coming(Instant::now());
                is_ready.fetch_or(comes, Ordering::SeqCst);
            }
        };
        in_parallel(plan, || service.wake(), || work(&|| is_ready.load(Ordering::SeqCst)))
    }

    /// Has fetched what a look finds worth fetching, for others than `pairs` that are looked at just now.
    fn plan_some(&mut self, step: &Step, components: &Components, pairs: &BTreeSet<[Identity; 2]>) -> Plan {
        let own: Vec<Identity> = step.service.own().iter().map(|snapshot| snapshot.agent).collect();
        let known: Vec<Identity> = step.all.iter().map(|snapshot| snapshot.agent).collect();
        let mut elsewhere = self.prefetcher.left_to_others(&known, &own, step.remote_results);
        elsewhere.extend(pairs);
        let mut plan = self.prefetcher.plan(&step.all, &own, &*step.store, &elsewhere, components);
        for (agent, (objects, rest)) in std::mem::take(&mut plan.wanted) {
            step.service.prefer(agent, objects, rest);
        }
        for (agent, reason) in std::mem::take(&mut plan.wrong) {
            step.leave_out(agent, reason);
        }
        let snapshot =
            step.all.iter().filter(|snapshot| !snapshot.entries.is_empty()).map(|snapshot| snapshot.agent);
        self.waits.look(snapshot, plan.pairs.iter().flat_map(|(pair, _)| pair), Instant::now());
        plan
    }
}

/// Does `work`, and `other` in a thread beside it, which is told and woken when that is over. Without a thread it is left.
fn in_parallel<T>(other: impl FnOnce(&AtomicBool) + Send, wake: impl Fn(), work: impl FnOnce() -> T) -> T {
    let ends = AtomicBool::new(false);
    thread::scope(|scope| {
        let flag = &ends;
        // Also where `work` breaks down: nobody waits for a thread for ever.
        let _end = End { flag, wake };
        let _ = thread::Builder::new().name("fleet-plan".into()).spawn_scoped(scope, move || other(flag));
        work()
    })
}

/// Says when it is dropped that something is over.
struct End<'a, W: Fn()> {
    flag: &'a AtomicBool,
    wake: W,
}

impl<W: Fn()> Drop for End<'_, W> {
    fn drop(&mut self) {
        self.flag.store(true, Ordering::SeqCst);
        (self.wake)();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};

    const PATIENCE: Duration = Duration::from_secs(30);

    /// Goes on until it is woken and told that it ends; says that it goes on.
    fn run_until_ended(ends: &AtomicBool, woken: &Receiver<()>, running: &Sender<()>) {
        while !ends.load(Ordering::SeqCst) {
            running.send(()).unwrap();
            assert_ne!(woken.recv_timeout(PATIENCE), Err(RecvTimeoutError::Timeout), "nobody wakes it");
        }
    }

    #[test]
    fn parallel_work_begins_before_the_work_ends_and_ends_with_it() {
        let ((wake, woken), (running, is_running)) = (channel(), channel());
        let wakes = || wake.send(()).unwrap();
        let other = move |ends: &AtomicBool| run_until_ended(ends, &woken, &running);
        let done = in_parallel(other, wakes, || is_running.recv_timeout(PATIENCE));
        assert_eq!(done, Ok(()));
        assert_eq!(is_running.recv(), Err(std::sync::mpsc::RecvError));
    }

    #[test]
    fn work_that_panics_ends_the_parallel_work() {
        let ((wake, woken), (running, is_running)) = (channel(), channel());
        let wakes = || wake.send(()).unwrap();
        let other = move |ends: &AtomicBool| run_until_ended(ends, &woken, &running);
        let work = || in_parallel(other, wakes, || panic!("as it should"));
        assert!(std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).is_err());
        assert!(is_running.try_iter().count() <= 1);
    }
}
