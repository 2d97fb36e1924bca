/* For test_write_order.py: preloaded, it notes every change to the file named by
 * CASTNET_WRITE_LOG_OF in CASTNET_WRITE_LOG, in order: what (w, t, r), offset or length,
 * number of bytes, bytes. Only calls that a child of vfork may make. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

static int log_fd = -1;
static const char *wanted;

__attribute__((constructor)) static void start(void)
{
    const char *path = getenv("CASTNET_WRITE_LOG");
    wanted = getenv("CASTNET_WRITE_LOG_OF");
    if (path && wanted) log_fd = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
}

static void note(char what, uint64_t at, uint64_t n, const void *bytes)
{
    uint64_t head[3] = {(uint64_t)what, at, n};
    if (syscall(SYS_write, log_fd, head, sizeof head) < 0 || (bytes && syscall(SYS_write, log_fd, bytes, n) < 0)) _exit(99);
}

/* Is it the file, under its name or the one that it has before? */
static int is_wanted(int fd)
{
    char link[64], path[4096];
    if (log_fd < 0) return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0) return 0;
    path[n] = 0;
    char *dot = strrchr(path, '.');
    if (!dot || (strcmp(dot, ".part") != 0 && strcmp(dot, ".tmp") != 0)) return 0;
    *dot = 0;
    return strcmp(path, wanted) == 0;
}

ssize_t pwrite64(int fd, const void *bytes, size_t n, off64_t at)
{
    ssize_t done = syscall(SYS_pwrite64, fd, bytes, n, at);
    if (done > 0 && is_wanted(fd)) note('w', (uint64_t)at, (uint64_t)done, bytes);
    return done;
}

ssize_t pwrite(int fd, const void *bytes, size_t n, off_t at) { return pwrite64(fd, bytes, n, at); }

int ftruncate64(int fd, off64_t length)
{
    int status = (int)syscall(SYS_ftruncate, fd, length);
    if (status == 0 && is_wanted(fd)) note('t', (uint64_t)length, 0, NULL);
    return status;
}

int ftruncate(int fd, off_t length) { return ftruncate64(fd, length); }

/* From here on others see the file: its name ends in .part. */
int rename(const char *from, const char *to)
{
    int status = (int)syscall(SYS_rename, from, to);
    const char *dot = strrchr(to, '.');
    if (status == 0 && log_fd >= 0 && dot && strcmp(dot, ".part") == 0) note('r', 0, 0, NULL);
    return status;
}
