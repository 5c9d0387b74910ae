//! What is deleted for room on the disk: the oldest first, never what is in use.

/// Something that is kept, in the order of age: the oldest first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kept<T> {
    /// What it is.
    pub what: T,
    /// Its size, bytes.
    pub bytes: u64,
    /// Whether it must stay.
    pub in_use: bool,
}

/// How much room there is and is to be, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Room {
    /// What may be kept in all.
    pub limit: u64,
    /// What is free on the file system, where it says so.
    pub free: Option<u64>,
    /// What is to stay free there.
    pub spare: u64,
}

/// What is to be done for room.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan<T> {
    /// What is to be deleted, in this order.
    pub delete: Vec<T>,
    /// Bytes that are kept then.
    pub kept: u64,
    /// Whether that is still more than is allowed.
    pub is_over: bool,
    /// Whether less than is to be is free even then.
    pub is_short: bool,
}

/// What is to be deleted of what is kept, so that it is within its limit and the file system has room left.
pub fn plan<T: Clone>(all: &[Kept<T>], room: Room) -> Plan<T> {
    let mut kept: u64 = all.iter().map(|one| one.bytes).sum();
    let mut free = room.free;
    let is_short = |free: Option<u64>| free.is_some_and(|free| free < room.spare);
    let mut delete = Vec::new();
    for one in all.iter().filter(|one| !one.in_use) {
        if kept <= room.limit && !is_short(free) {
            break;
        }
        kept -= one.bytes;
        free = free.map(|free| free.saturating_add(one.bytes));
        delete.push(one.what.clone());
    }
    Plan { delete, kept, is_over: kept > room.limit, is_short: is_short(free) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(sizes: &[(u64, bool)]) -> Vec<Kept<usize>> {
        let numbered = sizes.iter().enumerate();
        numbered.map(|(what, &(bytes, in_use))| Kept { what, bytes, in_use }).collect()
    }

    fn planned(sizes: &[(u64, bool)], limit: u64, free: Option<u64>, spare: u64) -> Plan<usize> {
        plan(&kept(sizes), Room { limit, free, spare })
    }

    #[test]
    fn the_oldest_is_deleted_first_and_no_more_than_needed() {
        let sizes = [(30, false), (20, false), (40, false)];
        assert!(planned(&sizes, 90, None, 0).delete.is_empty());
        assert_eq!(planned(&sizes, 89, None, 0).delete, [0]);
        assert_eq!(planned(&sizes, 60, None, 0).delete, [0]);
        let most = planned(&sizes, 59, None, 0);
        assert_eq!((most.delete, most.kept, most.is_over), (vec![0, 1], 40, false));
    }

    #[test]
    fn what_is_in_use_stays_however_old_and_large() {
        let plan = planned(&[(100, true), (20, false), (5, true)], 50, None, 0);
        assert_eq!((plan.delete, plan.kept, plan.is_over), (vec![1], 105, true));
    }

    #[test]
    fn a_file_system_that_others_fill_is_given_room() {
        let sizes = [(30, false), (20, false)];
        let enough = planned(&sizes, 1000, Some(5), 30);
        assert_eq!((enough.delete, enough.is_over, enough.is_short), (vec![0], false, false));
        let lacking = planned(&sizes, 1000, Some(5), 60);
        assert_eq!((lacking.delete, lacking.is_short), (vec![0, 1], true));
        assert!(!planned(&sizes, 1000, None, 60).is_short);
    }
}
