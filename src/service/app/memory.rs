//! Memory of the process: its quota, its current use, and accounts of its holders.
//!
//! Bodies and responses are charged to separate accounts, from before their memory is allocated until it is released.
//! In addition, large requests and responses are refused if the whole process would exceed its quota, before the kernel
//! ends it. The working memory of computations belongs to no account: beyond half of the quota they run one at a time,
//! beyond three quarters the cache is emptied.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicIsize, AtomicUsize, Ordering};
use std::time::Duration;

use super::cache::Cache;
use super::error::ServiceError;

/// Purpose for which memory is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Purpose {
    /// Request bodies and data parsed from them.
    Bodies,
    /// Responses, until they are sent.
    Answers,
}

/// Memory quota of the process and of each account.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quota {
    /// Resident bytes of the process.
    pub process: usize,
    /// Bytes of bodies.
    pub bodies: usize,
    /// Bytes of responses.
    pub answers: usize,
}

/// Objects below this size are never refused because of the whole process: refusals need memory too, and small objects
/// are bounded by the number of connections.
const SMALL: usize = 256 << 10;
/// Objects of at least this size cannot fill an account: a few clients with large requests must not block all others.
const LARGE: usize = 1 << 20;
/// Sampling interval of the resident memory.
const SAMPLING: Duration = Duration::from_millis(100);

#[derive(Debug)]
struct Account {
    most: usize,
    held: AtomicUsize,
}

impl Account {
    fn new(most: usize) -> Self {
        Self { most, held: AtomicUsize::new(0) }
    }

    /// Limit that applies to an object of `whole` bytes: large objects leave an eighth of the account to small ones.
    fn most_with(&self, whole: usize) -> usize {
        if whole >= LARGE { self.most / 8 * 7 } else { self.most }
    }

    /// Reserves `bytes` more for an object that then has `whole` bytes; returns whether they fit.
    fn take(&self, bytes: usize, whole: usize) -> bool {
        let most = self.most_with(whole);
        let fits = |held: usize| held.checked_add(bytes).filter(|held| *held <= most);
        self.held.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits).is_ok()
    }
}

#[derive(Debug)]
struct Accounts {
    process: usize,
    /// Resident bytes at the last sample; 0 before the first, and where the system does not report them.
    resident: AtomicUsize,
    /// Bytes of large objects granted lately: they may not be resident yet.
    granted: Granted,
    bodies: Account,
    answers: Account,
}

/// Net bytes granted since the last sample, and in the interval before it.
#[derive(Debug, Default)]
struct Granted {
    now: AtomicIsize,
    before: AtomicIsize,
}

impl Granted {
    fn add(&self, bytes: usize) {
        self.now.fetch_add(bytes.cast_signed(), Ordering::Relaxed);
    }

    fn release(&self, bytes: usize) {
        self.now.fetch_sub(bytes.cast_signed(), Ordering::Relaxed);
    }

    fn sum(&self) -> usize {
        let sum = self.now.load(Ordering::Relaxed).saturating_add(self.before.load(Ordering::Relaxed));
        usize::try_from(sum).unwrap_or(0)
    }

    /// Begins the next interval.
    fn turn(&self) {
        self.before.store(self.now.swap(0, Ordering::Relaxed), Ordering::Relaxed);
    }
}

impl Accounts {
    /// Takes a sample of the resident memory.
    fn sample(&self, resident: usize) {
        self.granted.turn();
        self.resident.store(resident, Ordering::Relaxed);
    }

    fn of(&self, purpose: Purpose) -> &Account {
        match purpose {
            Purpose::Bodies => &self.bodies,
            Purpose::Answers => &self.answers,
        }
    }
}

/// Memory accounting; cheap to clone.
#[derive(Debug, Clone)]
pub struct Memory(Arc<Accounts>);

impl Memory {
    /// Accounts with this quota.
    pub fn new(quota: Quota) -> Self {
        Self(Arc::new(Accounts {
            process: quota.process,
            resident: AtomicUsize::new(0),
            granted: Granted::default(),
            bodies: Account::new(quota.bodies),
            answers: Account::new(quota.answers),
        }))
    }

    /// Reserves `bytes` until the returned value is dropped.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if the memory is held by others; [`ServiceError::Invalid`] if the object is too
    /// large by itself.
    pub fn hold(&self, purpose: Purpose, bytes: usize) -> Result<Held, ServiceError> {
        let mut held = Held { memory: self.clone(), purpose, bytes: 0 };
        held.grow(bytes)?;
        Ok(held)
    }

    /// Bytes currently held for `purpose`.
    pub fn held(&self, purpose: Purpose) -> usize {
        self.0.of(purpose).held.load(Ordering::Relaxed)
    }

    /// Resident bytes of the process at the last sample.
    pub fn resident(&self) -> usize {
        self.0.resident.load(Ordering::Relaxed)
    }

    /// Whether `bytes` more fit in the process, for an object that then has `whole` bytes; counts them as granted if so.
    fn grant(&self, bytes: usize, whole: usize) -> bool {
        if whole < SMALL {
            return true;
        }
        let fits = self.expected().saturating_add(bytes) <= self.0.process;
        if fits {
            self.0.granted.add(bytes);
        }
        fits
    }

    /// Resident bytes of the process as far as they are known, with those granted since.
    fn expected(&self) -> usize {
        self.resident().saturating_add(self.0.granted.sum())
    }

    /// Whether half of the quota is in use. The working memory of requests that compute is not reserved, so they should
    /// then run one at a time.
    pub fn is_scarce(&self) -> bool {
        self.expected() > self.0.process / 2
    }

    /// Starts sampling the resident memory of the process, for the life of the service. While three quarters of the quota
    /// are in use, the cache is emptied, the least recently used values first. Values that nobody uses leave it in any case.
    /// Where the system does not report resident memory, only the accounts are bounded.
    pub fn watch(&self, cache: Arc<Cache>) {
        let accounts = Arc::downgrade(&self.0);
        tokio::spawn(async move {
            let mut ticks = tokio::time::interval(SAMPLING);
            loop {
                ticks.tick().await;
                let Some(accounts) = accounts.upgrade() else { return };
                let resident = resident_bytes().unwrap_or(0);
                accounts.sample(resident);
                use_large_pages(resident >= LARGE_PAGES_FROM);
                cache.drop_unused();
                if resident > accounts.process / 4 * 3 {
                    cache.halve();
                }
            }
        });
    }
}

/// Resident memory from which on new memory comes in pages of 2 MB: they make the mean with searched start points a quarter faster,
/// and a service at rest 16 MB larger.
const LARGE_PAGES_FROM: usize = 96 << 20;

/// Lets the kernel give pages of 2 MB, for which the allocator asks, or only small ones.
#[cfg(target_os = "linux")]
pub fn use_large_pages(large: bool) {
    if let Err(error) = rustix::thread::disable_transparent_huge_pages(!large) {
        tracing::debug!(%error, "the size of pages could not be chosen");
    }
}

/// Lets the kernel give pages of 2 MB; other systems choose by themselves.
#[cfg(not(target_os = "linux"))]
pub fn use_large_pages(_: bool) {}

/// Bytes per number in a response.
const NUMBER_BYTES: usize = 20;

impl Memory {
    /// Reserves the memory of a response with this count of numbers while it is computed.
    ///
    /// # Errors
    /// Those of [`Memory::hold`].
    pub fn foresee(&self, numbers: usize) -> Result<Held, ServiceError> {
        self.hold(Purpose::Answers, numbers.saturating_mul(NUMBER_BYTES))
    }
}

/// Memory held for a purpose, released on drop.
#[derive(Debug)]
pub struct Held {
    memory: Memory,
    purpose: Purpose,
    bytes: usize,
}

impl Held {
    /// Reserves further bytes.
    ///
    /// # Errors
    /// Those of [`Memory::hold`]; the reservation is then unchanged.
    pub fn grow(&mut self, bytes: usize) -> Result<(), ServiceError> {
        let account = self.memory.0.of(self.purpose);
        let whole = self.bytes.saturating_add(bytes);
        if whole > account.most_with(whole) {
            return Err(too_much(self.purpose, whole, account.most_with(whole)));
        }
        if !self.memory.grant(bytes, whole) || !account.take(bytes, whole) {
            return Err(ServiceError::Overloaded(full(self.purpose).into()));
        }
        self.bytes = whole;
        Ok(())
    }

    /// Changes the reservation to exactly `bytes`.
    ///
    /// # Errors
    /// Those of [`Memory::hold`]; the reservation is then unchanged.
    pub fn resize(&mut self, bytes: usize) -> Result<(), ServiceError> {
        self.grow_to(bytes)?;
        self.release(self.bytes.saturating_sub(bytes));
        Ok(())
    }

    /// Raises the reservation to `bytes`.
    ///
    /// # Errors
    /// Those of [`Memory::hold`]; the reservation is then unchanged.
    pub fn grow_to(&mut self, bytes: usize) -> Result<(), ServiceError> {
        if bytes > self.bytes { self.grow(bytes - self.bytes) } else { Ok(()) }
    }

    /// Gives `bytes` of the reservation back.
    fn release(&mut self, bytes: usize) {
        if self.bytes >= SMALL {
            self.memory.0.granted.release(bytes);
        }
        self.memory.0.of(self.purpose).held.fetch_sub(bytes, Ordering::Relaxed);
        self.bytes -= bytes;
    }

    /// Reserved bytes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.release(self.bytes);
    }
}

fn full(purpose: Purpose) -> &'static str {
    match purpose {
        Purpose::Bodies => "the memory for request bodies is full",
        Purpose::Answers => "the memory for answers is full",
    }
}

fn too_much(purpose: Purpose, bytes: usize, most: usize) -> ServiceError {
    let what = match purpose {
        Purpose::Bodies => "reading the body would take",
        Purpose::Answers => "the answer would take",
    };
    let detail =
        format!("{what} about {bytes} bytes of memory, at most {most} are available: ask for less at a time");
    ServiceError::invalid("", detail)
}

/// Resident bytes of this process, if the system reports them.
pub fn resident_bytes() -> Option<usize> {
    kib_of(&read("/proc/self/status"), "VmRSS:")
}

/// Assumed memory of a machine that does not report it.
const UNKNOWN: usize = 4 << 30;

/// Memory available to this process: the smallest limit of its control groups, and at most the memory of the machine.
pub fn available() -> usize {
    let machine = kib_of(&read("/proc/meminfo"), "MemTotal:").unwrap_or(UNKNOWN);
    group_bytes(&read("/proc/self/cgroup"), Path::new("/sys/fs/cgroup"))
        .map_or(machine, |group| group.min(machine))
}

fn read(path: impl AsRef<Path>) -> String {
    std::fs::read_to_string(path).unwrap_or_default()
}

/// Bytes given by a line such as `MemTotal:  16384 kB`.
fn kib_of(text: &str, name: &str) -> Option<usize> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: usize = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib << 10)
}

/// Smallest limit of the control groups named in `text` (`/proc/self/cgroup`) and their ancestors, for both versions of
/// control groups.
fn group_bytes(text: &str, root: &Path) -> Option<usize> {
    let limits = text.lines().flat_map(|line| {
        let mut parts = line.splitn(3, ':').skip(1);
        let (controllers, path) = (parts.next().unwrap_or_default(), parts.next().unwrap_or_default());
        let (root, file) = match controllers {
            "" => (root.to_owned(), "memory.max"),
            _ if controllers.split(',').any(|name| name == "memory") => {
                (root.join("memory"), "memory.limit_in_bytes")
            }
            _ => return Vec::new(),
        };
        let group = root.join(path.trim_start_matches('/'));
        // In a container the path is that of the host, and the visible root is the container's own group.
        let groups = group.ancestors().take_while(|group| group.starts_with(&root));
        groups.filter_map(|group| read(group.join(file)).trim().parse().ok()).collect()
    });
    limits.min()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn memory(process: usize) -> Memory {
        Memory::new(Quota { process, bodies: 1000, answers: 10 << 20 })
    }

    #[test]
    fn what_is_held_is_given_back() {
        let memory = memory(usize::MAX);
        let mut first = memory.hold(Purpose::Bodies, 600).unwrap();
        let refused = memory.hold(Purpose::Bodies, 500);
        assert!(matches!(refused, Err(ServiceError::Overloaded(_))), "{refused:?}");
        let never = memory.hold(Purpose::Bodies, 1001);
        assert!(matches!(never, Err(ServiceError::Invalid(_))), "{never:?}");
        assert!(first.grow(401).is_err());
        assert_eq!((first.bytes(), memory.held(Purpose::Bodies)), (600, 600));
        first.resize(100).unwrap();
        let second = memory.hold(Purpose::Bodies, 900).unwrap();
        assert_eq!(memory.held(Purpose::Bodies), 1000);
        drop((first, second));
        assert_eq!(memory.held(Purpose::Bodies), 0);
    }

    #[test]
    fn what_is_large_is_refused_when_the_process_is_full() {
        let memory = memory(100 << 20);
        memory.0.sample(99 << 20);
        assert!(memory.hold(Purpose::Answers, 2 << 20).is_err());
        assert!(memory.hold(Purpose::Answers, SMALL - 1).is_ok());
        memory.0.sample(95 << 20);
        let first = memory.hold(Purpose::Answers, 4 << 20).unwrap();
        assert!(memory.hold(Purpose::Answers, 4 << 20).is_err(), "the first may not be resident yet");
        memory.0.sample(95 << 20);
        assert!(memory.hold(Purpose::Answers, 4 << 20).is_err(), "nor after one sample");
        drop(first);
        assert!(memory.hold(Purpose::Answers, 4 << 20).is_ok(), "it is gone");
        memory.0.sample(95 << 20);
        memory.0.sample(95 << 20);
        assert!(memory.hold(Purpose::Answers, 4 << 20).is_ok());
    }

    #[test]
    fn what_is_large_leaves_room_for_what_is_small() {
        let memory = memory(usize::MAX);
        let large = memory.hold(Purpose::Answers, 8 << 20).unwrap();
        assert!(memory.hold(Purpose::Answers, 1 << 20).is_err());
        let small = memory.hold(Purpose::Answers, (1 << 20) - 1).unwrap();
        drop(large);
        assert!(matches!(memory.hold(Purpose::Answers, 9 << 20), Err(ServiceError::Invalid(_))));
        drop(small);
        // Further pieces of an object that has become large are refused too.
        let memory = Memory::new(Quota { process: 1, bodies: 1 << 30, answers: 0 });
        let mut body = memory.hold(Purpose::Bodies, 0).unwrap();
        while body.bytes() < SMALL - 1024 {
            body.grow(1024).unwrap();
        }
        assert!(body.grow(1024).is_err());
    }

    #[tokio::test]
    async fn the_resident_memory_is_looked_at() {
        let memory = memory(usize::MAX);
        memory.watch(Arc::new(Cache::new(1 << 30, Duration::from_secs(600))));
        tokio::time::sleep(3 * SAMPLING).await;
        assert_eq!(memory.resident() > 1 << 20, cfg!(target_os = "linux"));
    }

    #[test]
    fn limits_of_groups_are_found_in_both_versions() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let put = |path: &str, text: &str| {
            let file = root.join(path);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, text).unwrap();
        };
        assert_eq!(group_bytes("0::/\n", root), None);
        put("memory.max", "max\n");
        assert_eq!(group_bytes("0::/a/b\n", root), None);
        put("a/memory.max", "2147483648\n");
        put("a/b/memory.max", "max\n");
        assert_eq!(group_bytes("0::/a/b\n", root), Some(2 << 30));
        put("memory/docker/x/memory.limit_in_bytes", "1073741824\n");
        put("memory/memory.limit_in_bytes", "9223372036854771712\n");
        let text = "12:cpu,cpuacct:/docker/x\n7:memory:/docker/x\n";
        assert_eq!(group_bytes(text, root), Some(1 << 30));
        assert_eq!(kib_of("MemFree: 1 kB\nMemTotal:       16384 kB\n", "MemTotal:"), Some(16 << 20));
        assert!(available() > 1 << 20);
    }
}
