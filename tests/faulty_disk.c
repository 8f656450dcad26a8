/* Library that simulates disk faults in tests. It is preloaded, so that the tested program is the one that ships.

   The library counts the operations that change files below a folder. From the operation whose number the test sets, the
   operations stall until the test ends the fault, or fail with an error. A log records all operations; `faulty_disk.py`
   computes from the log the files that remain after a power cut. The test and the library share one page of memory
   (struct control). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

struct control {
    int64_t count;   /* changes so far */
    int64_t at;      /* number of the change at which the fault begins; negative: no fault */
    int32_t fault;   /* an errno, or STALL */
    int32_t active;
    int32_t waiting; /* threads that are stalled */
    int32_t logs;
    char folder[1024];
    char log[1024];
};

enum { STALL = -1 };
enum op { WRITE = 1, TRUNCATE, SYNC, RENAME, UNLINK, CREATE, MKDIR, RMDIR, LINK };

static struct control *control;
static pthread_mutex_t order = PTHREAD_MUTEX_INITIALIZER;

__attribute__((constructor)) static void begin(void) {
    const char *path = getenv("CARINA_FAULTY_DISK");
    int fd = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_RDWR) : -1;
    if (fd < 0) return;
    void *page = mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    syscall(SYS_close, fd);
    if (page != MAP_FAILED) control = page;
}

#define REAL(name) \
    static __typeof__(name) *real; \
    if (!real) real = (__typeof__(name) *)dlsym(RTLD_NEXT, #name)

static int is_ours(const char *path) {
    if (!control || !path || !control->folder[0]) return 0;
    size_t length = strlen(control->folder);
    return strncmp(path, control->folder, length) == 0 && (path[length] == '/' || path[length] == 0);
}

static int path_of(int fd, char *path, size_t size) {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, size - 1);
    path[length < 0 ? 0 : length] = 0;
    return control && is_ours(path) && !strstr(path, " (deleted)");
}

/* Return 0 to continue, or -1 with errno. A full disk (ENOSPC) still does operations with takes_room 0. */
static int gate(int takes_room) {
    int64_t n = __atomic_add_fetch(&control->count, 1, __ATOMIC_SEQ_CST);
    if (control->at >= 0 && n >= control->at) __atomic_store_n(&control->active, 1, __ATOMIC_SEQ_CST);
    if (!__atomic_load_n(&control->active, __ATOMIC_SEQ_CST)) return 0;
    if (control->fault == STALL) {
        __atomic_add_fetch(&control->waiting, 1, __ATOMIC_SEQ_CST);
        while (__atomic_load_n(&control->active, __ATOMIC_SEQ_CST)) usleep(1000);
        __atomic_sub_fetch(&control->waiting, 1, __ATOMIC_SEQ_CST);
        return 0;
    }
    if (control->fault == ENOSPC && !takes_room) return 0;
    errno = control->fault;
    return -1;
}

static void note(enum op op, const char *path, const char *other, uint64_t offset, const void *data, uint64_t size) {
    if (!control->logs) return;
    uint32_t lengths[3] = {op, (uint32_t)strlen(path), other ? (uint32_t)strlen(other) : 0};
    uint64_t numbers[2] = {offset, data ? size : 0};
    int kept = errno;
    int fd = (int)syscall(SYS_openat, AT_FDCWD, control->log, O_WRONLY | O_CREAT | O_APPEND, 0600);
    const void *parts[5] = {lengths, numbers, path, other, data};
    size_t sizes[5] = {sizeof lengths, sizeof numbers, lengths[1], lengths[2], (size_t)numbers[1]};
    for (int n = 0; n < 5; n++)
        if (sizes[n] && syscall(SYS_write, fd, parts[n], sizes[n]) != (long)sizes[n]) abort();
    syscall(SYS_close, fd);
    errno = kept;
}

#define IN_ORDER(type, call, said) \
    pthread_mutex_lock(&order); \
    type found = call; \
    if (found >= 0) { said; } \
    pthread_mutex_unlock(&order); \
    return found

ssize_t write(int fd, const void *data, size_t size) {
    REAL(write);
    char path[4096];
    if (!control || fd < 3 || !path_of(fd, path, sizeof path)) return real(fd, data, size);
    if (gate(1)) return -1;
    IN_ORDER(ssize_t, real(fd, data, size),
             note(WRITE, path, NULL, (uint64_t)lseek(fd, 0, SEEK_CUR) - (uint64_t)found, data, (uint64_t)found));
}

static ssize_t write_at(ssize_t (*real)(int, const void *, size_t, off_t), int fd, const void *data, size_t size,
                        off_t offset) {
    char path[4096];
    if (!control || !path_of(fd, path, sizeof path)) return real(fd, data, size, offset);
    if (gate(1)) return -1;
    IN_ORDER(ssize_t, real(fd, data, size, offset), note(WRITE, path, NULL, (uint64_t)offset, data, (uint64_t)found));
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t offset) {
    REAL(pwrite);
    return write_at(real, fd, data, size, offset);
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset) {
    REAL(pwrite64);
    return write_at((ssize_t(*)(int, const void *, size_t, off_t))real, fd, data, size, offset);
}

static int cut(int (*real)(int, off_t), int fd, off_t length) {
    char path[4096];
    if (!control || !path_of(fd, path, sizeof path)) return real(fd, length);
    if (gate(length > 0)) return -1;
    IN_ORDER(int, real(fd, length), note(TRUNCATE, path, NULL, (uint64_t)length, NULL, 0));
}

int ftruncate(int fd, off_t length) {
    REAL(ftruncate);
    return cut(real, fd, length);
}

int ftruncate64(int fd, off64_t length) {
    REAL(ftruncate64);
    return cut((int (*)(int, off_t))real, fd, length);
}

static int synced(int (*real)(int), int fd) {
    char path[4096];
    if (!control || !path_of(fd, path, sizeof path)) return real(fd);
    if (gate(0)) return -1;
    IN_ORDER(int, real(fd), note(SYNC, path, NULL, 0, NULL, 0));
}

int fsync(int fd) {
    REAL(fsync);
    return synced(real, fd);
}

int fdatasync(int fd) {
    REAL(fdatasync);
    return synced(real, fd);
}

int rename(const char *from, const char *to) {
    REAL(rename);
    if (!is_ours(to)) return real(from, to);
    if (gate(1)) return -1;
    IN_ORDER(int, real(from, to), note(RENAME, from, to, 0, NULL, 0));
}

int link(const char *from, const char *to) {
    REAL(link);
    if (!is_ours(to)) return real(from, to);
    if (gate(1)) return -1;
    IN_ORDER(int, real(from, to), note(LINK, from, to, 0, NULL, 0));
}

int unlink(const char *path) {
    REAL(unlink);
    if (!is_ours(path)) return real(path);
    if (gate(0)) return -1;
    IN_ORDER(int, real(path), note(UNLINK, path, NULL, 0, NULL, 0));
}

int mkdir(const char *path, mode_t mode) {
    REAL(mkdir);
    if (!is_ours(path)) return real(path, mode);
    if (gate(1)) return -1;
    IN_ORDER(int, real(path, mode), note(MKDIR, path, NULL, 0, NULL, 0));
}

int rmdir(const char *path) {
    REAL(rmdir);
    if (!is_ours(path)) return real(path);
    if (gate(0)) return -1;
    IN_ORDER(int, real(path), note(RMDIR, path, NULL, 0, NULL, 0));
}

static int opened(int (*real)(const char *, int, ...), const char *path, int flags, mode_t mode) {
    int writes = (flags & O_ACCMODE) != O_RDONLY || (flags & (O_CREAT | O_TRUNC));
    if (!writes || !is_ours(path)) return real(path, flags, mode);
    struct stat found_before;
    int is_new = (flags & O_CREAT) && stat(path, &found_before) != 0;
    if (is_new || (control->fault == EROFS && control->active)) {
        if (gate(is_new)) return -1;
    }
    IN_ORDER(int, real(path, flags, mode), {
        if (is_new) note(CREATE, path, NULL, 0, NULL, 0);
        if (!is_new && (flags & O_TRUNC)) note(TRUNCATE, path, NULL, 0, NULL, 0);
    });
}

#define MODE \
    mode_t mode = 0; \
    if (flags & (O_CREAT | O_TMPFILE)) { \
        va_list list; \
        va_start(list, flags); \
        mode = va_arg(list, mode_t); \
        va_end(list); \
    }

int open(const char *path, int flags, ...) {
    REAL(open);
    MODE
    return opened(real, path, flags, mode);
}

int open64(const char *path, int flags, ...) {
    REAL(open64);
    MODE
    return opened(real, path, flags, mode);
}
