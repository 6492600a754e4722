//! A disk of our own, a file system in a file: one that does not answer for as long as we like, frozen by the kernel
//! (whoever writes to it waits; nobody's processor is busy with it), or one whose content at one moment is looked at, as a
//! power cut would leave it.

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
    /// A file for the content of disk number `number`, in memory where there is such a folder: the speed of this machine's
    /// own disk, which others use, is not what is tested.
    pub fn image(number: u64) -> PathBuf {
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        folder.join(format!("plumbline-disk-{}-{number}", std::process::id()))
    }

    /// Mounts a new one at `at`; where that is not allowed, why not.
    pub fn mount(at: &Path) -> Result<Self, String> {
        let image = &Self::image(0);
        std::fs::File::create(image).unwrap().set_len(SIZE).unwrap();
        if !ran("mkfs.ext4", &["-q".as_ref(), "-F".as_ref(), image.as_os_str()]) {
            let _ = std::fs::remove_file(image);
            return Err("mkfs.ext4 is missing or failed".into());
        }
        Self::of(image, at)
    }

    /// Mounts `image`, which is removed in the end, at `at`.
    ///
    /// # Errors
    /// Why not.
    pub fn of(image: &Path, at: &Path) -> Result<Self, String> {
        std::fs::create_dir_all(at).unwrap();
        if !ran("mount", &["-o".as_ref(), "loop".as_ref(), image.as_os_str(), at.as_os_str()]) {
            let _ = std::fs::remove_file(image);
            return Err(format!("nothing can be mounted at {} (it takes root, and loop devices)", at.display()));
        }
        Ok(Self { at: at.to_owned(), image: image.to_owned() })
    }

    /// Copies what the device holds at this moment: what the file system has not sent to it yet is not in the copy.
    pub fn copy_to(&self, image: &Path) {
        assert!(ran("cp", &["--sparse=always".as_ref(), self.image.as_os_str(), image.as_os_str()]), "no copy");
    }

    /// Sends everything to the device.
    pub fn sync(&self) {
        let folder = std::fs::File::open(&self.at).unwrap();
        // SAFETY: a plain system call on a file of ours.
        assert_eq!(unsafe { libc::syncfs(folder.as_raw_fd()) }, 0, "{}", std::io::Error::last_os_error());
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

fn ran(program: &str, arguments: &[&std::ffi::OsStr]) -> bool {
    Command::new(program).args(arguments).output().is_ok_and(|ran| ran.status.success())
}

impl Drop for Disk {
    fn drop(&mut self) {
        self.thaw();
        let _ = Command::new("umount").arg("--lazy").arg(&self.at).output();
        let _ = std::fs::remove_file(&self.image);
    }
}
