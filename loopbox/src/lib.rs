//! Run agents, merge their maps, evaluate what came of it: what the program `loopbox` does, for other programs. Prints
//! nothing, installs no signal handlers and starts no global pool of threads.

pub mod lidar;
