//! Tables of times and names, and the time that goes forward through their stamps.
#![no_main]

use scans::tables::{Numbers, Table, decoded};
use sources::forward::{StampVerdict, check_stamps};
use std::path::Path;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    let table = Table::parse(&decoded(data));
    let files: Vec<_> = table.rows.iter().filter_map(|row| row.file(1, Path::new("/nowhere"))).collect();
    let numbers = Numbers::of(files.iter().map(|file| file.as_path()));
    let _ = numbers.map(|numbers| (numbers.gaps(), numbers.places_in(table.rows.len())));
    for name in [None, Some(0), Some(1)] {
        let _ =
            table.times_of(name).map(|times| (table.stamps_at(times).is_ok(), table.is_increasing(times)));
    }
    let Ok(stamps) = table.stamps() else { return };
    let _ = stamps.remark();
    let times = check_stamps(&stamps.seconds).0.into_iter();
    let times = times.filter_map(|one| if let StampVerdict::At(time) = one { Some(time) } else { None });
    assert!(times.is_sorted(), "time goes forward");
});
