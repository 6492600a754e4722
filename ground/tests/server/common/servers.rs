//! Servers of other programs, started where they are installed; what is skipped is said.

use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::os::unix::fs::{PermissionsExt as _, chown};
use std::os::unix::process::CommandExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use plumbline_experiment::draw::Dice;

/// Something that takes longer does not come any more.
pub const PATIENCE: Duration = Duration::from_secs(120);
/// Who runs PostgreSQL where the tests are run by root, as whom it refuses to run: nobody.
const NOBODY: u32 = 65_534;

/// Draws who is killed and when; `PLUMBLINE_SEED` has other draws.
pub fn drawn() -> Dice {
    let seed = std::env::var("PLUMBLINE_SEED").map_or(1, |seed| seed.parse().unwrap());
    println!("kills are drawn from seed {seed}");
    Dice::new(seed)
}

/// Ends with its test.
pub struct Process(pub Child);

impl Process {
    pub fn start(command: &mut Command) -> Self {
        Self(command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap())
    }

    pub fn kill(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
    }
}

pub fn free_port() -> u16 {
    TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port()
}

pub fn listens(port: u16) {
    let begun = Instant::now();
    while TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_err() {
        assert!(begun.elapsed() < PATIENCE, "nobody listens at {port}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A NATS server that keeps its streams in a folder.
pub struct Nats {
    process: Process,
    port: u16,
    folder: PathBuf,
}

impl Nats {
    /// `None` where there is none to start.
    pub fn start(folder: &Path) -> Option<Self> {
        if Self::server().arg("--version").output().is_err() {
            plumbline_agent::recordings::skipped("no nats-server (a Debian package)");
            return None;
        }
        let (port, folder) = (free_port(), folder.join("nats"));
        Some(Self { process: Self::process(&folder, port), port, folder })
    }

    fn server() -> Command {
        Command::new(std::env::var_os("PLUMBLINE_NATS").unwrap_or_else(|| "nats-server".into()))
    }

    fn process(folder: &Path, port: u16) -> Process {
        let mut command = Self::server();
        let process =
            Process::start(command.args(["-js", "-a", "127.0.0.1", "-p", &port.to_string(), "-sd"]).arg(folder));
        listens(port);
        process
    }

    pub fn kill(&mut self) {
        self.process.kill();
    }

    pub fn start_again(&mut self) {
        self.process = Self::process(&self.folder, self.port);
    }

    pub fn kill_and_start_again(&mut self) {
        self.kill();
        self.start_again();
    }

    pub fn url(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }
}

/// A PostgreSQL server that keeps its databases in a folder.
pub struct Postgres {
    process: Process,
    port: u16,
    folder: PathBuf,
}

impl Postgres {
    /// `None` where there is none to start.
    pub fn start(folder: &Path) -> Option<Self> {
        if Self::program("initdb").arg("--version").output().is_ok_and(|ran| ran.status.success()) {
            let (port, folder) = (free_port(), folder.join("postgres"));
            std::fs::create_dir(&folder).unwrap();
            if is_root() {
                // A folder of this test alone: whoever runs the server must get there.
                let parent = folder.parent().unwrap();
                std::fs::set_permissions(parent, std::fs::Permissions::from_mode(0o755)).unwrap();
                chown(&folder, Some(NOBODY), Some(NOBODY)).unwrap();
            }
            let mut initdb = Self::program("initdb");
            let made = initdb
                .args(["--auth=trust", "--no-sync", "--no-locale", "-E", "UTF8", "-U", "plumbline", "-D"])
                .arg(&folder)
                .output()
                .unwrap();
            assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
            return Some(Self { process: Self::process(&folder, port), port, folder });
        }
        plumbline_agent::recordings::skipped("no PostgreSQL (a Debian package)");
        None
    }

    fn program(name: &str) -> Command {
        let folder = std::env::var_os("PLUMBLINE_POSTGRES").map(PathBuf::from);
        let mut command = Command::new(folder.map_or_else(|| name.into(), |folder| folder.join(name)));
        if is_root() {
            command.uid(NOBODY).gid(NOBODY);
        }
        command.current_dir("/");
        command
    }

    /// One that was killed leaves processes that end a moment after it; until then no other begins.
    fn process(folder: &Path, port: u16) -> Process {
        let begun = Instant::now();
        loop {
            let mut command = Self::program("postgres");
            command.args(["-h", "127.0.0.1", "-p", &port.to_string(), "-k", ""]).args(["-F", "-D"]).arg(folder);
            let mut process = Process::start(&mut command);
            while process.0.try_wait().unwrap().is_none() {
                if TcpStream::connect((Ipv4Addr::LOCALHOST, port)).is_ok() {
                    return process;
                }
                std::thread::sleep(Duration::from_millis(20));
            }
            assert!(begun.elapsed() < PATIENCE, "no PostgreSQL at {port}");
        }
    }

    /// As a power cut leaves it.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    pub fn start_again(&mut self) {
        self.process = Self::process(&self.folder, self.port);
    }

    /// Of a database; `postgres` is there from the beginning.
    pub fn url(&self, database: &str) -> String {
        format!("postgresql://plumbline@127.0.0.1:{}/{database}", self.port)
    }
}

fn is_root() -> bool {
    std::fs::metadata("/proc/self").is_ok_and(|meta| std::os::unix::fs::MetadataExt::uid(&meta) == 0)
}

/// Makes or deletes a bucket of an S3 double, whole; or says what lies in it.
const BUCKET: &str = "
import sys, boto3
s3 = boto3.resource('s3', endpoint_url=sys.argv[1], region_name='us-east-1', aws_access_key_id='k', aws_secret_access_key='s')
bucket = s3.Bucket(sys.argv[2])
if sys.argv[3] == 'make':
    bucket.create()
elif sys.argv[3] == 'list':
    print('\\n'.join(sorted(thing.key for thing in bucket.objects.all())))
else:
    bucket.objects.all().delete()
    bucket.delete()
";

/// A double of S3-compatible storage; its bucket is not there yet.
pub struct Bucket {
    _process: Process,
    python: std::ffi::OsString,
    address: String,
    name: &'static str,
}

impl Bucket {
    /// `None` where there is none to start.
    pub fn start(name: &'static str) -> Option<Self> {
        let python = std::env::var_os("PLUMBLINE_PYTHON").unwrap_or_else(|| "python3".into());
        let has = Command::new(&python).args(["-c", "import boto3, moto.server, flask"]).output();
        if !has.is_ok_and(|ran| ran.status.success()) {
            plumbline_agent::recordings::skipped("no Python with moto[server]");
            return None;
        }
        let port = free_port();
        let main = "import sys; from moto.server import main; main(['-p', sys.argv[1]])";
        let process = Process::start(Command::new(&python).args(["-c", main, &port.to_string()]));
        listens(port);
        Some(Self { _process: process, python, address: format!("http://127.0.0.1:{port}"), name })
    }

    fn run(&self, what: &str) -> String {
        let ran = Command::new(&self.python).args(["-c", BUCKET, &self.address, self.name, what]).output().unwrap();
        assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
        String::from_utf8(ran.stdout).unwrap()
    }

    pub fn make(&self) {
        self.run("make");
    }

    pub fn delete(&self) {
        self.run("delete");
    }

    pub fn keys(&self) -> Vec<String> {
        self.run("list").split_whitespace().map(str::to_owned).collect()
    }

    /// For a program's environment.
    pub fn settings(&self) -> [(&'static str, &str); 5] {
        [
            ("AWS_ACCESS_KEY_ID", "k"),
            ("AWS_SECRET_ACCESS_KEY", "s"),
            ("AWS_REGION", "us-east-1"),
            ("AWS_ENDPOINT", &self.address),
            ("AWS_ALLOW_HTTP", "true"),
        ]
    }
}
