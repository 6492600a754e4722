//! A disk that does not answer for as long as we like: a file system of its own, frozen by the kernel. Whoever writes to
//! it waits; nobody's processor is busy with it.

use std::os::fd::AsRawFd as _;
use std::path::{Path, PathBuf};
use std::process::Command;

// _IOWR('X', 119, int) and _IOWR('X', 120, int) of linux/fs.h.
const FIFREEZE: libc::Ioctl = 0xc004_5877_u32 as libc::Ioctl;
const FITHAW: libc::Ioctl = 0xc004_5878_u32 as libc::Ioctl;
const SIZE: u64 = 512 << 20;

/// A mounted file system; thawed and unmounted when dropped.
pub struct Disk {
    at: PathBuf,
    image: PathBuf,
}

impl Disk {
    /// Mounts one at `at`; `None` where that is not allowed.
    pub fn mount(at: &Path) -> Option<Self> {
        std::fs::create_dir_all(at).unwrap();
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let image = folder.join(format!("plumbline-disk-{}", std::process::id()));
        std::fs::File::create(&image).unwrap().set_len(SIZE).unwrap();
        let ran = |program: &str, arguments: &[&std::ffi::OsStr]| {
            Command::new(program).args(arguments).output().is_ok_and(|ran| ran.status.success())
        };
        let made = ran("mkfs.ext4", &["-q".as_ref(), "-F".as_ref(), image.as_os_str()])
            && ran("mount", &["-o".as_ref(), "loop".as_ref(), image.as_os_str(), at.as_os_str()]);
        if !made {
            let _ = std::fs::remove_file(&image);
            return None;
        }
        Some(Self { at: at.to_owned(), image })
    }

    /// From now on every write waits.
    pub fn freeze(&self) {
        assert!(self.ask(FIFREEZE), "the file system cannot be frozen: {}", std::io::Error::last_os_error());
    }

    /// Writes go on.
    pub fn thaw(&self) {
        self.ask(FITHAW);
    }

    fn ask(&self, what: libc::Ioctl) -> bool {
        let folder = std::fs::File::open(&self.at).unwrap();
        // SAFETY: these two take no memory of ours.
        unsafe { libc::ioctl(folder.as_raw_fd(), what, 0) == 0 }
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        self.thaw();
        let _ = Command::new("umount").arg("--lazy").arg(&self.at).output();
        let _ = std::fs::remove_file(&self.image);
    }
}
