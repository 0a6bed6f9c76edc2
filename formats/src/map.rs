//! A memory map that survives a file changing under it.
//!
//! In: an open file. Out: [`GuardedMap`], its bytes, shared with the page cache. Reading a page
//! that the file no longer has raises SIGBUS, which ends a program; here it does not: a handler,
//! installed once, puts a page of zeros in place of the missing one and marks the map, and the
//! next [`GuardedMap::check`] is an error. Guaranteed: a file that shrinks never crashes the
//! reader, and a shrink, a growth, a rewrite or a replacement is an error of the `check` that
//! follows. Not guaranteed: that bytes read before that `check` are the file's; so bytes are to
//! be used first and trusted after the check. Faults elsewhere go to the handler that was
//! installed before. On Windows a mapped file cannot be cut, and no handler is needed.

use std::fs::{File, Metadata};
use std::io;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use memmap2::Mmap;

use crate::error::Error;

/// What tells one state of a file from another.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Fingerprint {
    length: u64,
    modified: Option<SystemTime>,
    identity: Option<(u64, u64)>,
}

impl Fingerprint {
    pub(crate) fn of(metadata: &Metadata) -> Self {
        #[cfg(unix)]
        let identity = {
            use std::os::unix::fs::MetadataExt;
            Some((metadata.dev(), metadata.ino()))
        };
        #[cfg(not(unix))]
        let identity = None;
        Self {
            length: metadata.len(),
            modified: metadata.modified().ok(),
            identity,
        }
    }

    /// An error if the file is no longer what it was when the fingerprint was taken.
    /// Without a path, nobody can have replaced the file.
    pub(crate) fn check(&self, file: &File, path: Option<&Path>) -> Result<(), Error> {
        let name = || {
            path.map_or("copied input".to_string(), |path| {
                path.display().to_string()
            })
        };
        let metadata = file
            .metadata()
            .map_err(|e| Error::io(name(), "cannot be examined again", e))?;
        let now = Self::of(&metadata);
        if now.length != self.length {
            let how = if now.length < self.length {
                "shrank"
            } else {
                "grew"
            };
            return Err(Error::invalid(
                name(),
                format!(
                    "the file {how} while it was being read: {} bytes now, {} when it was opened",
                    now.length, self.length
                ),
            )
            .at(now.length.min(self.length)));
        }
        if now.modified != self.modified {
            return Err(Error::invalid(
                name(),
                "the file was written to while it was being read",
            ));
        }
        // A path that is gone is no reason to stop: the open file is still whole.
        if let Some(path) = path
            && let Ok(metadata) = std::fs::metadata(path)
            && Self::of(&metadata).identity != self.identity
        {
            return Err(Error::invalid(
                name(),
                "the file was replaced while it was being read",
            ));
        }
        Ok(())
    }
}

/// The bytes of a file, mapped, with a guard against the file changing.
#[derive(Debug)]
pub(crate) struct GuardedMap {
    // Declared before `map`: dropped first, so the guard never covers foreign addresses.
    guard: guard::Guard,
    map: Mmap,
    file: File,
    path: PathBuf,
    fingerprint: Fingerprint,
}

impl GuardedMap {
    /// Maps `file`, which is at `path`. `None` when no guard could be set, and the file is then
    /// better read than mapped.
    pub(crate) fn new(file: File, path: &Path) -> io::Result<Option<Self>> {
        let metadata = file.metadata()?;
        let fingerprint = Fingerprint::of(&metadata);
        // SAFETY: the map is read-only and private to this struct, which unmaps it on drop. Other
        // processes may still change the file: pages that vanish are replaced by the guard, and
        // bytes that change are plain numbers on which no memory safety rests; `check` turns
        // either into an error.
        let map = unsafe { Mmap::map(&file)? };
        if map.len() as u64 != fingerprint.length {
            return Err(io::Error::other(
                "the file changed while it was being opened",
            ));
        }
        let Some(guard) = guard::Guard::new(map.as_ptr() as usize, map.len()) else {
            return Ok(None);
        };
        Ok(Some(Self {
            guard,
            map,
            file,
            path: path.to_path_buf(),
            fingerprint,
        }))
    }

    /// An error if the file changed since it was mapped, or if a page of it was missing.
    pub(crate) fn check(&self) -> Result<(), Error> {
        self.fingerprint.check(&self.file, Some(&self.path))?;
        if self.guard.was_hit() {
            return Err(Error::invalid(
                self.path.display().to_string(),
                "a part of the file could not be read: it was cut meanwhile, or the disk failed",
            ));
        }
        Ok(())
    }

    /// The mapped bytes. Call [`GuardedMap::check`] before and after using them.
    pub(crate) fn bytes(&self) -> &[u8] {
        &self.map
    }

    /// Says that the bytes will be read from front to back.
    pub(crate) fn expect_sequential(&self) {
        #[cfg(unix)]
        // Advice only: a failure changes nothing but speed.
        let _ = self.map.advise(memmap2::Advice::Sequential);
    }

    /// Maps the pages of `start..end` that are there in one go, which takes a third of the time of a fault
    /// for every few pages, and waits for the others to be read.
    pub(crate) fn fetch(&self, start: usize, end: usize) {
        #[cfg(target_os = "linux")]
        if let Some(count) = end.min(self.map.len()).checked_sub(start) {
            // Advice only: where it is not known, or the file has shrunk, pages come when they are touched.
            let _ = self
                .map
                .advise_range(memmap2::Advice::PopulateRead, start, count);
        }
        #[cfg(not(target_os = "linux"))]
        let _ = (start, end);
    }

    /// Says that `start..end` will be read soon, so that the device goes on while what was read is used.
    pub(crate) fn expect(&self, start: usize, end: usize) {
        #[cfg(unix)]
        if let Some(count) = end.min(self.map.len()).checked_sub(start) {
            // Advice only, as above.
            let _ = self
                .map
                .advise_range(memmap2::Advice::WillNeed, start, count);
        }
        #[cfg(not(unix))]
        let _ = (start, end);
    }

    /// Takes the pages of `start..end`, without the last if it is not whole, out of this process's
    /// resident memory. They come back from the page cache when touched again.
    pub(crate) fn release(&self, start: usize, end: usize) {
        #[cfg(unix)]
        {
            let page = guard::page_bytes();
            let start = start / page * page;
            let end = end.min(self.map.len()) / page * page;
            if start >= end {
                return;
            }
            // SAFETY: the range lies within the map, on page borders. The map is read-only and
            // file-backed, so dropped pages are read again from the file on the next access.
            // Failure is harmless: the pages stay resident.
            unsafe {
                let first = self.map.as_ptr().add(start) as *mut libc::c_void;
                libc::madvise(first, end - start, libc::MADV_DONTNEED);
            }
        }
        #[cfg(not(unix))]
        let _ = (start, end);
    }
}

#[cfg(unix)]
mod guard {
    //! The SIGBUS handler and the table of maps it protects.

    use std::sync::OnceLock;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

    /// More maps than this at once are not guarded, and their files are read instead. The handler
    /// scans the whole table, so it should not be huge.
    const SLOTS: usize = 256;

    struct Slot {
        taken: AtomicBool,
        /// First address, or 0 while the slot guards nothing.
        start: AtomicUsize,
        bytes: AtomicUsize,
        hit: AtomicBool,
    }

    static TABLE: [Slot; SLOTS] = [const {
        Slot {
            taken: AtomicBool::new(false),
            start: AtomicUsize::new(0),
            bytes: AtomicUsize::new(0),
            hit: AtomicBool::new(false),
        }
    }; SLOTS];

    /// Set before the handler is installed; the handler only reads it.
    static PAGE_BYTES: AtomicUsize = AtomicUsize::new(0);
    static PREVIOUS: OnceLock<libc::sigaction> = OnceLock::new();
    static INSTALLED: OnceLock<bool> = OnceLock::new();

    pub(super) fn page_bytes() -> usize {
        let known = PAGE_BYTES.load(Ordering::Relaxed);
        if known != 0 {
            return known;
        }
        // SAFETY: sysconf has no preconditions.
        let found = unsafe { libc::sysconf(libc::_SC_PAGESIZE) };
        let found = usize::try_from(found).unwrap_or(4096).max(1);
        PAGE_BYTES.store(found, Ordering::Relaxed);
        found
    }

    /// An entry of the table, given back on drop.
    #[derive(Debug)]
    pub(super) struct Guard {
        slot: usize,
    }

    impl Guard {
        /// Guards `bytes` bytes from the address `start`; `None` when the table is full or the
        /// handler cannot be installed.
        pub(super) fn new(start: usize, bytes: usize) -> Option<Self> {
            if !*INSTALLED.get_or_init(install) {
                return None;
            }
            let slot = TABLE.iter().position(|slot| {
                slot.taken
                    .compare_exchange(false, true, Ordering::AcqRel, Ordering::Relaxed)
                    .is_ok()
            })?;
            let entry = &TABLE[slot];
            entry.hit.store(false, Ordering::Relaxed);
            entry.bytes.store(bytes, Ordering::Relaxed);
            // Last: from here on the handler takes the entry for valid.
            entry.start.store(start, Ordering::Release);
            Some(Self { slot })
        }

        pub(super) fn was_hit(&self) -> bool {
            TABLE[self.slot].hit.load(Ordering::Acquire)
        }
    }

    impl Drop for Guard {
        fn drop(&mut self) {
            let entry = &TABLE[self.slot];
            entry.start.store(0, Ordering::Release);
            entry.taken.store(false, Ordering::Release);
        }
    }

    fn install() -> bool {
        page_bytes();
        // SAFETY: `previous` and `action` are plain C structs that sigaction fills or reads, for
        // which all zeros is a valid value. The handler does only what is allowed in one: atomics
        // and system calls.
        unsafe {
            let mut previous: libc::sigaction = std::mem::zeroed();
            if libc::sigaction(libc::SIGBUS, std::ptr::null(), &mut previous) != 0 {
                return false;
            }
            // Known before the handler can run, as the handler must not wait for it.
            let _ = PREVIOUS.set(previous);
            let mut action: libc::sigaction = std::mem::zeroed();
            let handler: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) =
                on_sigbus;
            action.sa_sigaction = handler as libc::sighandler_t;
            action.sa_flags = libc::SA_SIGINFO | libc::SA_NODEFER | libc::SA_ONSTACK;
            libc::sigemptyset(&mut action.sa_mask);
            libc::sigaction(libc::SIGBUS, &action, std::ptr::null_mut()) == 0
        }
    }

    #[cfg(any(target_os = "linux", target_os = "emscripten"))]
    fn errno() -> *mut libc::c_int {
        // SAFETY: gives the address of this thread's errno, always valid.
        unsafe { libc::__errno_location() }
    }

    #[cfg(any(target_os = "macos", target_os = "ios", target_os = "freebsd"))]
    fn errno() -> *mut libc::c_int {
        // SAFETY: gives the address of this thread's errno, always valid.
        unsafe { libc::__error() }
    }

    #[cfg(not(any(
        target_os = "linux",
        target_os = "emscripten",
        target_os = "macos",
        target_os = "ios",
        target_os = "freebsd"
    )))]
    fn errno() -> *mut libc::c_int {
        std::ptr::null_mut()
    }

    extern "C" fn on_sigbus(
        signal: libc::c_int,
        info: *mut libc::siginfo_t,
        context: *mut libc::c_void,
    ) {
        // SAFETY: the kernel passes a valid siginfo_t to a handler installed with SA_SIGINFO.
        // si_code > 0 says the kernel raised the signal for a fault, so si_addr is its address.
        let (code, address) = unsafe { ((*info).si_code, (*info).si_addr() as usize) };
        if code > 0 && patch(address) {
            return;
        }
        forward(signal, info, context);
    }

    /// Puts a page of zeros at `address` if a guarded map is there.
    fn patch(address: usize) -> bool {
        for slot in &TABLE {
            let start = slot.start.load(Ordering::Acquire);
            if start == 0 || address < start {
                continue;
            }
            let page = PAGE_BYTES.load(Ordering::Relaxed);
            // The last page of a map is mapped whole, so the guarded range ends on a page border.
            let Some(bytes) = slot
                .bytes
                .load(Ordering::Relaxed)
                .checked_next_multiple_of(page)
            else {
                continue;
            };
            if address - start >= bytes {
                continue;
            }
            let saved = errno();
            // SAFETY: the page holding `address` belongs to a live read-only map of this crate
            // (its guard is dropped before it is unmapped), so replacing it touches nobody else.
            // mmap is a plain system call; errno is put back as the interrupted code left it.
            unsafe {
                let value = if saved.is_null() { 0 } else { *saved };
                let at = (address / page * page) as *mut libc::c_void;
                let put = libc::mmap(
                    at,
                    page,
                    libc::PROT_READ,
                    libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_FIXED,
                    -1,
                    0,
                );
                if !saved.is_null() {
                    *saved = value;
                }
                if put == libc::MAP_FAILED {
                    return false;
                }
            }
            slot.hit.store(true, Ordering::Release);
            return true;
        }
        false
    }

    /// Hands the signal to whoever had it before.
    fn forward(signal: libc::c_int, info: *mut libc::siginfo_t, context: *mut libc::c_void) {
        let Some(previous) = PREVIOUS.get() else {
            return;
        };
        let handler = previous.sa_sigaction;
        if handler == libc::SIG_DFL || handler == libc::SIG_IGN {
            // Give the signal its default action and return: the faulting instruction runs again
            // and ends the program as it would have without us. A signal sent by a process is
            // not repeated by itself, so send it again.
            // SAFETY: resets one signal to its default action and raises it; both are allowed in
            // a handler. `info` is valid as in `on_sigbus`.
            unsafe {
                let sent = (*info).si_code <= 0;
                if sent && handler == libc::SIG_IGN {
                    return;
                }
                libc::signal(signal, libc::SIG_DFL);
                if sent {
                    libc::raise(signal);
                }
            }
            return;
        }
        // SAFETY: the previous action is a function, of the kind its flags say, and is called as
        // the kernel would have called it.
        unsafe {
            if previous.sa_flags & libc::SA_SIGINFO != 0 {
                let function: extern "C" fn(libc::c_int, *mut libc::siginfo_t, *mut libc::c_void) =
                    std::mem::transmute(handler);
                function(signal, info, context);
            } else {
                let function: extern "C" fn(libc::c_int) = std::mem::transmute(handler);
                function(signal);
            }
        }
    }
}

#[cfg(not(unix))]
mod guard {
    //! Nothing to guard: a mapped file cannot be cut here.

    #[derive(Debug)]
    pub(super) struct Guard;

    impl Guard {
        pub(super) fn new(_start: usize, _bytes: usize) -> Option<Self> {
            Some(Self)
        }

        pub(super) fn was_hit(&self) -> bool {
            false
        }
    }
}
