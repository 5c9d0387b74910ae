use super::super::optimisation::Optimised;
use super::*;
use crate::results::Owner;
use fleet::merge_results::PlacedAgent;
use map::Uuid;
use std::io::{Error, ErrorKind};
use std::path::Path;

fn agent(number: u128) -> Identity {
    Identity { uuid: Uuid::from_u128(number), epoch: 0 }
}

fn found(number: u128) -> MergeResults {
    let (agent, root) = (agent(number).to_string(), agent(number).to_string());
    let (name, root_from_agent) = (String::new(), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0]);
    let agents = vec![PlacedAgent { agent, name, keyframes: 9, whole: true, root, root_from_agent }];
    MergeResults { agents, pair_verdicts: Vec::new() }
}

/// One at work on state 3, and what comes of it.
fn at_work(out: &Path, written: Option<Result<()>>) -> (Whole, Outcome) {
    let results = Results::create(out, &Owner::Merge, false).unwrap();
    let mut whole = Whole::new(results, out.join("verdicts"), false).unwrap();
    (0..3).for_each(|_| whole.came());
    whole.is_new = false;
    let (found, undone) = (found(3), vec![([agent(1), agent(2)], "why".to_owned())]);
    let optimised = Ok(Optimised { fused: Vec::new(), found, undone, has_met: true, written });
    let results = whole.results.take().unwrap();
    (whole, Outcome { revision: 3, results, took: Duration::from_secs(2), optimised })
}

#[test]
fn what_is_settled_of_what_is_there_is_taken_as_it_is() {
    let room = tempfile::tempdir().unwrap();
    let (mut whole, outcome) = at_work(room.path(), Some(Ok(())));
    let mut table = Schedule::new(Instant::now());
    assert!(!whole.is_done());
    assert!(whole.adopt(outcome, &mut table, &mut []).is_ok_and(|has_changed| has_changed));
    assert!(whole.found == found(3) && whole.is_done() && whole.results.is_some());
    assert!(!table.may_optimise(true, Instant::now()));
}

#[test]
fn of_what_changed_meanwhile_it_is_known_what_was_taken_back_and_the_rest_is_done_again() {
    let room = tempfile::tempdir().unwrap();
    let (mut whole, outcome) = at_work(room.path(), Some(Ok(())));
    let start = Instant::now();
    let mut table = Schedule::new(start);
    whole.came();
    whole.is_new = false;
    assert!(whole.adopt(outcome, &mut table, &mut []).is_ok_and(|has_changed| !has_changed));
    assert!(whole.found == MergeResults::default() && whole.undone.len() == 1);
    // Where agents are without what was taken back is to be said.
    assert!(std::mem::take(&mut whole.is_new) && !whole.is_done());
    whole.is_left = true;
    whole.look_after(&table, start + Duration::from_secs(9));
    assert!(!whole.is_new);
    whole.look_after(&table, start + Duration::from_secs(30));
    assert!(whole.is_new);
}

#[test]
fn what_was_not_written_is_written_again_and_failures_are_not_repeated_for_ever() {
    let room = tempfile::tempdir().unwrap();
    let full = Error::from(ErrorKind::StorageFull);
    let (mut whole, outcome) = at_work(room.path(), Some(Err(full.into())));
    let mut table = Schedule::new(Instant::now());
    let Err(Failed::Write(_)) = whole.adopt(outcome, &mut table, &mut []) else { panic!("it is told") };
    assert!(!whole.is_done() && !whole.is_new);
    whole.request_write();
    assert!(whole.is_new);
    drop(whole);
    let (mut whole, outcome) = at_work(room.path(), None);
    let outcome = Outcome { optimised: Err(anyhow::anyhow!("no map")), ..outcome };
    let Err(Failed::Merge(_)) = whole.adopt(outcome, &mut table, &mut []) else { panic!("it is told") };
    whole.look_after(&table, Instant::now() + Duration::from_secs(99));
    assert!(!whole.is_new && !whole.is_done());
}
