/* A disk that fails or is slow, for one process: loaded before libc (LD_PRELOAD), it stands in for the calls that touch files below a
 * folder `artifacts`. The file that RELUME_TEST_FAULTS names says what is wrong, as "read|write|both ERRNO MILLISECONDS BYTES": with errno 0 it
 * is only slow, and reads before that byte of a file succeed. Without the file nothing is wrong. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

static volatile char tracked[1 << 16];

static int ours(const char *path) { return path && strstr(path, "/artifacts") != NULL; }
static int is_tracked(int fd) { return fd >= 0 && fd < (1 << 16) && tracked[fd]; }

/* Whether a call at a place of a file fails, with errno set; waits before where that is asked for. */
static int fails_at(const char *kind, off_t at) {
    const char *path = getenv("RELUME_TEST_FAULTS");
    if (!path) return 0;
    int fd = (int)syscall(SYS_openat, AT_FDCWD, path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return 0;
    char text[64] = {0}, which[16] = {0};
    long count = syscall(SYS_read, fd, text, sizeof text - 1);
    syscall(SYS_close, fd);
    int number = 0, delay = 0;
    long from = 0;
    if (count <= 0 || sscanf(text, "%15s %d %d %ld", which, &number, &delay, &from) != 4) return 0;
    if (at < from) return 0;
    if (strcmp(which, "both") != 0 && strcmp(which, kind) != 0) return 0;
    if (delay > 0) usleep((useconds_t)delay * 1000);
    errno = number;
    return number != 0;
}

static int fails(const char *kind) { return fails_at(kind, 0); }

#define REAL(result, name, ...)                                                          \
    static result (*real)(__VA_ARGS__);                                                  \
    if (!real) real = (result(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name);

#define OPEN(name)                                                                       \
    int name(const char *path, int flags, ...) {                                         \
        REAL(int, name, const char *, int, ...)                                          \
        va_list list;                                                                    \
        va_start(list, flags);                                                           \
        mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(list, mode_t) : 0;        \
        va_end(list);                                                                    \
        int changes = (flags & (O_WRONLY | O_RDWR | O_CREAT)) != 0;                      \
        if (ours(path) && changes && fails("write")) return -1;                          \
        int fd = real(path, flags, mode);                                                \
        if (fd >= 0 && fd < (1 << 16)) tracked[fd] = (char)ours(path);                   \
        return fd;                                                                       \
    }
OPEN(open)
OPEN(open64)

int close(int fd) {
    REAL(int, close, int)
    if (fd >= 0 && fd < (1 << 16)) tracked[fd] = 0;
    return real(fd);
}

#define ON_FILE(kind, result, name, parameters, arguments, ...)                          \
    result name parameters {                                                             \
        REAL(result, name, __VA_ARGS__)                                                  \
        if (is_tracked(fd) && fails(kind)) return -1;                                    \
        return real arguments;                                                           \
    }
ssize_t read(int fd, void *to, size_t count) {
    REAL(ssize_t, read, int, void *, size_t)
    if (is_tracked(fd) && fails_at("read", lseek(fd, 0, SEEK_CUR))) return -1;
    return real(fd, to, count);
}
ON_FILE("read", ssize_t, pread64, (int fd, void *to, size_t count, off64_t at), (fd, to, count, at), int, void *, size_t, off64_t)
ON_FILE("write", ssize_t, write, (int fd, const void *from, size_t count), (fd, from, count), int, const void *, size_t)
ON_FILE("write", ssize_t, pwrite64, (int fd, const void *from, size_t count, off64_t at), (fd, from, count, at), int, const void *, size_t, off64_t)
ON_FILE("write", ssize_t, writev, (int fd, const struct iovec *parts, int count), (fd, parts, count), int, const struct iovec *, int)
ON_FILE("write", int, fsync, (int fd), (fd), int)
ON_FILE("write", int, fdatasync, (int fd), (fd), int)
ON_FILE("write", int, ftruncate64, (int fd, off64_t length), (fd, length), int, off64_t)

#define ON_PATHS(name)                                                                   \
    int name(const char *from, const char *to) {                                         \
        REAL(int, name, const char *, const char *)                                      \
        if ((ours(from) || ours(to)) && fails("write")) return -1;                       \
        return real(from, to);                                                           \
    }
ON_PATHS(rename)
ON_PATHS(link)

int linkat(int from_folder, const char *from, int to_folder, const char *to, int flags) {
    REAL(int, linkat, int, const char *, int, const char *, int)
    if ((ours(from) || ours(to)) && fails("write")) return -1;
    return real(from_folder, from, to_folder, to, flags);
}

int mkdir(const char *path, mode_t mode) {
    REAL(int, mkdir, const char *, mode_t)
    if (ours(path) && fails("write")) return -1;
    return real(path, mode);
}

int unlink(const char *path) {
    REAL(int, unlink, const char *)
    if (ours(path) && fails("write")) return -1;
    return real(path);
}
