//! Who hears of the common maps as they are merged: ROS 2, a page.

use crate::lidar::merging::LidarMerging;
use crate::ros::Common;
use merge::common_map::Fused;

/// Hears of the common maps, in the thread that merges.
pub trait CommonListener: Send + Sync {
    /// Cameras' maps were merged anew; agents that met nobody are alone in theirs.
    fn cameras(&mut self, merged: &[Fused]);

    /// LiDARs' maps were merged anew.
    fn lidars(&mut self, _merging: &LidarMerging) {}

    /// Some time went by.
    fn tick(&mut self) {}
}

impl CommonListener for Common {
    fn cameras(&mut self, merged: &[Fused]) {
        self.publish_cameras(merged);
    }

    fn lidars(&mut self, merging: &LidarMerging) {
        self.publish_lidars(merging);
    }

    fn tick(&mut self) {
        Common::tick(self);
    }
}

/// Of several common maps that do not hang together the one of the most keyframes is shown.
#[cfg(feature = "view")]
impl CommonListener for view::watch::CommonMap {
    fn cameras(&mut self, merged: &[Fused]) {
        // Of equals the first, whatever came later.
        let largest = merged.iter().rev().max_by_key(|fused| fused.map.keyframes.len());
        if let Some(fused) = largest {
            // Maps of cameras alone are merged here.
            let _ = self.show(&fused.map);
        }
    }
}
