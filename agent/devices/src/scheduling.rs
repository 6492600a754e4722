//! Real-time priority of the threads that a flight waits for.
//!
//! The motors' watch comes before the flight thread, and that before the devices' readers: what samples arrive late, or not
//! at all, because a log is written or a page is drawn on the same computer looks like a sensor that fails.

/// Of the motors' watch: above the flight thread, so that one that spins cannot keep it off.
pub const MOTOR_WATCH: i32 = 60;
/// Of the flight thread.
pub const FLIGHT: i32 = 50;
/// Of a device's reader.
pub const READER: i32 = 40;

/// Asks for real-time `priority` (`SCHED_FIFO`) of this thread and of those that it starts from now on, and for memory that
/// stays.
///
/// # Errors
/// The system's refusal: a process needs `CAP_SYS_NICE` or `LimitRTPRIO` for it.
pub fn real_time(priority: i32) -> std::io::Result<()> {
    let parameters = libc::sched_param { sched_priority: priority };
    // SAFETY: plain system calls; 0 is the calling thread.
    if unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO, &raw const parameters) } != 0 {
        return Err(std::io::Error::last_os_error());
    }
    // SAFETY: a plain system call.
    if unsafe { libc::mlockall(libc::MCL_CURRENT) } != 0 {
        tracing::warn!(error = %std::io::Error::last_os_error(), "memory is not locked; ticks may wait for a page");
    }
    Ok(())
}

/// Asks for it; a refusal is reported and lived with.
pub fn ask_for_real_time(priority: i32) {
    let thread = std::thread::current();
    match real_time(priority) {
        Ok(()) => tracing::info!(thread = thread.name(), priority, "real-time priority"),
        Err(error) => {
            tracing::warn!(%error, thread = thread.name(), "no real-time priority; ticks may be late under load");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_unit_lets_every_thread_have_its_priority() {
        let unit = include_str!("../../package/plumbline-agent.service");
        let limit = unit.lines().find_map(|line| line.strip_prefix("LimitRTPRIO=")).unwrap();
        assert_eq!(limit.parse::<i32>(), Ok([MOTOR_WATCH, FLIGHT, READER].into_iter().max().unwrap()));
    }
}
