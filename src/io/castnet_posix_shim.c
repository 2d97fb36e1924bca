/* The few calls of the operating system that Fortran has no word for.
 * Every procedure returns 0 or errno unless it says otherwise; texts come in with
 * their final zero. Nothing here runs a shell or follows a link that it did not expect.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdio.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

/* ---- signals ---------------------------------------------------------------- */

static volatile sig_atomic_t stop_signal = 0;

/* The first signal asks, the second ends the process at once with the same code. */
static void on_signal(int number)
{
    if (stop_signal != 0) _exit(number == SIGINT ? 130 : 75);
    stop_signal = number;
}

int castnet_install_signals(void)
{
    static const int caught[] = {SIGUSR1, SIGTERM, SIGINT, SIGHUP};
    struct sigaction action, before;
    for (size_t i = 0; i < sizeof caught / sizeof caught[0]; i++) {
        if (sigaction(caught[i], NULL, &before) != 0) return errno;
        /* nohup and shells' background jobs ignore hang-ups and interrupts: so do we */
        if (before.sa_handler == SIG_IGN && (caught[i] == SIGHUP || caught[i] == SIGINT)) continue;
        memset(&action, 0, sizeof action);
        action.sa_handler = on_signal;
        action.sa_flags = SA_RESTART; /* no half-done write */
        sigemptyset(&action.sa_mask);
        if (sigaction(caught[i], &action, NULL) != 0) return errno;
    }
    /* a file size limit is to be an error of the write, not the end of the process */
    memset(&action, 0, sizeof action);
    action.sa_handler = SIG_IGN;
    sigemptyset(&action.sa_mask);
    return sigaction(SIGXFSZ, &action, NULL) == 0 ? 0 : errno;
}

/* 0: none, 1: stop (SIGUSR1, SIGTERM, SIGHUP), 2: interrupted (SIGINT) */
int castnet_stop_request(void) { return stop_signal == 0 ? 0 : stop_signal == SIGINT ? 2 : 1; }

/* ---- files ------------------------------------------------------------------ */

static int write_all(int fd, const char *data, int64_t n)
{
    while (n > 0) {
        ssize_t done = write(fd, data, n > (1 << 30) ? (size_t)(1 << 30) : (size_t)n);
        if (done < 0) {
            if (errno == EINTR) continue;
            return errno;
        }
        data += done;
        n -= done;
    }
    return 0;
}

/* Create a file that must not exist yet, fill it, force it to the disk. */
int castnet_create_file(const char *path, const char *data, int64_t n)
{
    int fd = open(path, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
    if (fd < 0) return errno;
    int status = write_all(fd, data, n);
    if (status == 0 && fsync(fd) != 0 && errno != EINVAL && errno != ENOSYS) status = errno;
    if (close(fd) != 0 && status == 0) status = errno;
    return status;
}

/* Cut a file (made if need be) to `length` bytes and write these behind. What a full disk
 * leaves of them is cut off again. */
int castnet_append_file(const char *path, int64_t length, const char *data, int64_t n)
{
    int fd = open(path, O_WRONLY | O_CREAT | O_NOFOLLOW | O_CLOEXEC, 0644);
    if (fd < 0) return errno;
    int status = ftruncate(fd, (off_t)length) != 0 || lseek(fd, (off_t)length, SEEK_SET) < 0 ? errno : 0;
    if (status == 0) status = write_all(fd, data, n);
    if (status != 0 && ftruncate(fd, (off_t)length) != 0) { /* the checksums tell what is whole */ }
    if (close(fd) != 0 && status == 0) status = errno;
    return status;
}

/* Read at most n bytes from the start; `done` says how many came. */
int castnet_read_file(const char *path, char *data, int64_t n, int64_t *done)
{
    *done = 0;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return errno;
    int status = 0;
    while (*done < n) {
        int64_t want = n - *done > (1 << 30) ? (1 << 30) : n - *done;
        ssize_t got = read(fd, data + *done, (size_t)want);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) status = errno;
        if (got <= 0) break;
        *done += got;
    }
    close(fd);
    return status;
}

/* Remove a file if it still holds exactly these bytes; EAGAIN if it does not. The lock
 * on the open file keeps two that try at once from removing each other's successor. */
int castnet_remove_if_unchanged(const char *path, const char *data, int64_t n)
{
    char seen[1024];
    struct stat here, there;
    int64_t got = 0;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return errno == ENOENT ? EAGAIN : errno;
    if (flock(fd, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
        close(fd);
        return EAGAIN;
    }
    while (got < (int64_t)sizeof seen) {
        ssize_t k = read(fd, seen + got, sizeof seen - (size_t)got);
        if (k <= 0) break;
        got += k;
    }
    int status = 0;
    if (fstat(fd, &here) != 0 || stat(path, &there) != 0 || here.st_ino != there.st_ino
        || here.st_dev != there.st_dev || got != n || memcmp(seen, data, (size_t)n) != 0) status = EAGAIN;
    if (status == 0 && unlink(path) != 0) status = errno;
    close(fd);
    return status;
}

/* Copy a file to a name that must not exist yet. Its holes stay holes. */
int castnet_copy_file(const char *from, const char *to)
{
    static const size_t block = 1 << 20;
    int in = open(from, O_RDONLY | O_CLOEXEC);
    if (in < 0) return errno;
    int out = open(to, O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0644);
    if (out < 0) {
        int status = errno;
        close(in);
        return status;
    }
    int status = 0;
    char *buffer = malloc(block);
    if (buffer == NULL) status = ENOMEM;
    while (status == 0) {
        ssize_t got = read(in, buffer, block);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) status = errno;
        if (got <= 0) break;
        if (buffer[0] == 0 && memcmp(buffer, buffer + 1, (size_t)got - 1) == 0)
            status = lseek(out, got, SEEK_CUR) < 0 ? errno : 0;
        else
            status = write_all(out, buffer, got);
    }
    if (status == 0 && ftruncate(out, lseek(out, 0, SEEK_CUR)) != 0) status = errno;
    free(buffer);
    close(in);
    if (close(out) != 0 && status == 0) status = errno;
    if (status != 0) unlink(to);
    return status;
}

/* Force a file or a folder to the disk. */
int castnet_sync_path(const char *path)
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return errno;
    int status = fsync(fd) == 0 || errno == EINVAL || errno == ENOSYS ? 0 : errno;
    close(fd);
    return status;
}

int castnet_rename(const char *from, const char *to) { return rename(from, to) == 0 ? 0 : errno; }

/* A folder that may be there already. */
int castnet_make_folder(const char *path)
{
    struct stat s;
    if (mkdir(path, 0777) == 0) return 0;
    int status = errno;
    return status == EEXIST && stat(path, &s) == 0 && S_ISDIR(s.st_mode) ? 0 : status;
}

int castnet_remove_file(const char *path) { return unlink(path) == 0 ? 0 : errno; }

/* A second name for the same file; the new name must not exist. */
int castnet_link(const char *from, const char *to) { return link(from, to) == 0 ? 0 : errno; }

/* 0: nothing there, 1: regular file, 2: folder, 3: something else, -1: cannot tell */
int castnet_path_kind(const char *path)
{
    struct stat s;
    if (stat(path, &s) != 0) return errno == ENOENT || errno == ENOTDIR ? 0 : -1;
    return S_ISREG(s.st_mode) ? 1 : S_ISDIR(s.st_mode) ? 2 : 3;
}

/* Bytes of a file, negative errno if it cannot be asked. */
int64_t castnet_file_size(const char *path)
{
    struct stat s;
    return stat(path, &s) == 0 ? (int64_t)s.st_size : -(int64_t)errno;
}

/* Are these two names of one existing file? */
int castnet_same_file(const char *a, const char *b)
{
    struct stat s, t;
    return stat(a, &s) == 0 && stat(b, &t) == 0 && s.st_dev == t.st_dev && s.st_ino == t.st_ino;
}

/* May this process write into the folder (or file)? Asks the mount too. */
int castnet_may_write(const char *path) { return access(path, W_OK) == 0 ? 0 : errno; }

/* Longest name in a folder, -1 if unlimited or unknown. */
int castnet_longest_name(const char *folder) { return (int)pathconf(folder, _PC_NAME_MAX); }

int castnet_longest_path(void) { return PATH_MAX; }

/* Bytes that this process may still write where `path` is, -1 if unknown. */
int64_t castnet_free_space(const char *path)
{
    struct statvfs s;
    if (statvfs(path, &s) != 0 || s.f_blocks == 0) return -1;
    return (int64_t)s.f_bavail * (int64_t)s.f_frsize;
}

/* Set disk space aside behind the end of a file without changing its size, so that
 * what is written there later cannot fail for want of space. A file system that has
 * no such call is asked for its free space instead. */
int castnet_reserve_space(const char *path, int64_t from, int64_t bytes)
{
    struct rlimit limit;
    if (bytes <= 0) return 0;
    if (getrlimit(RLIMIT_FSIZE, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY
        && (uint64_t)from + (uint64_t)bytes > limit.rlim_cur) return EFBIG;
    int fd = open(path, O_WRONLY | O_CLOEXEC);
    if (fd < 0) return errno;
    int status;
    do {
        status = fallocate(fd, FALLOC_FL_KEEP_SIZE, from, bytes) == 0 ? 0 : errno;
    } while (status == EINTR);
    close(fd);
    if (status == EOPNOTSUPP || status == ENOSYS || status == EINVAL || status == EPERM) {
        int64_t left = castnet_free_space(path);
        status = left >= 0 && left < bytes ? ENOSPC : 0;
    }
    return status;
}

/* Give back what was set aside behind the end of a file. */
int castnet_release_space(const char *path)
{
    struct stat s;
    if (stat(path, &s) != 0) return errno;
    return truncate(path, s.st_size) == 0 ? 0 : errno;
}

/* ---- the process and its machine -------------------------------------------- */

int castnet_is_terminal(int fd) { return isatty(fd) == 1; }

int castnet_process(void) { return (int)getpid(); }

int castnet_process_alive(int pid) { return pid > 0 && (kill((pid_t)pid, 0) == 0 || errno == EPERM); }

/* When a process started, in clock ticks since the machine did; -1 if unknown. Tells a
 * process from a later one that was given the same number. */
int64_t castnet_process_start(int pid)
{
    char path[64], text[1024];
    int64_t got = 0;
    char digits[16];
    int n = 0, k = 0;
    if (pid <= 0) return -1;
    for (int p = pid; p > 0; p /= 10) digits[n++] = (char)('0' + p % 10);
    memcpy(path, "/proc/", 6);
    k = 6;
    while (n > 0) path[k++] = digits[--n];
    memcpy(path + k, "/stat", 6);
    if (castnet_read_file(path, text, sizeof text - 1, &got) != 0 || got <= 0) return -1;
    text[got] = 0;
    char *at = strrchr(text, ')'); /* the name may hold anything, the last bracket ends it */
    for (int field = 2; at != NULL && field < 22; field++) at = strchr(at + 1, ' ');
    return at == NULL ? -1 : (int64_t)strtoll(at + 1, NULL, 10);
}

int castnet_host_name(char *name, int n)
{
    if (gethostname(name, (size_t)n) != 0) return errno;
    name[n - 1] = 0;
    return 0;
}

/* Seconds of a clock that never jumps. */
double castnet_wall_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1.0e-9 * (double)t.tv_nsec;
}

/* Now as ISO 8601, UTC, to the second; n must be at least 21. */
void castnet_time_stamp(char *text, int n)
{
    time_t now = time(NULL);
    struct tm parts;
    gmtime_r(&now, &parts);
    if (strftime(text, (size_t)n, "%Y-%m-%dT%H:%M:%SZ", &parts) == 0) text[0] = 0;
}

/* The number that a file starts with, or `otherwise`. */
static int64_t number_in(const char *path, int64_t otherwise)
{
    long long number;
    FILE *file = fopen(path, "re");
    if (file == NULL) return otherwise;
    if (fscanf(file, "%lld", &number) != 1) number = otherwise;
    fclose(file);
    return number;
}

/* The least of what the control groups of this process allow it, a batch system's job among
 * them [bytes], or `most`. A line of /proc/self/cgroup is number:controllers:path. */
static int64_t group_memory(int64_t most)
{
    char line[2048], path[2200];
    FILE *groups = fopen("/proc/self/cgroup", "re");
    if (groups == NULL) return most;
    while (fgets(line, sizeof line, groups) != NULL) {
        char *controllers = strchr(line, ':'), *group = controllers ? strchr(controllers + 1, ':') : NULL;
        if (group == NULL) continue;
        *group++ = 0;
        group[strcspn(group, "\n")] = 0;
        int new_form = controllers[1] == 0;
        if (!new_form && strstr(controllers + 1, "memory") == NULL) continue;
        for (;;) {
            snprintf(path, sizeof path, new_form ? "/sys/fs/cgroup%s/memory.max" : "/sys/fs/cgroup/memory%s/memory.limit_in_bytes",
                     group);
            int64_t allowed = number_in(path, most);
            if (allowed > 0 && allowed < most) most = allowed;
            char *last = strrchr(group, '/');
            if (last == NULL) break;
            *last = 0;
        }
    }
    fclose(groups);
    return most;
}

/* Memory of the machine [bytes], less if the process or its job is limited. */
int64_t castnet_physical_memory(void)
{
    struct rlimit limit;
    int64_t bytes = (int64_t)sysconf(_SC_PHYS_PAGES) * (int64_t)sysconf(_SC_PAGESIZE);
    if (getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY
        && (int64_t)limit.rlim_cur < bytes) bytes = (int64_t)limit.rlim_cur;
    return group_memory(bytes);
}

/* Set a variable of the environment unless the user has. */
void castnet_default_environment(const char *name, const char *value) { setenv(name, value, 0); }

int castnet_errno(void) { return errno; }

void castnet_clear_errno(void) { errno = 0; }

void castnet_error_text(int number, char *text, int n)
{
    char buffer[256];
    const char *words = strerror_r(number, buffer, sizeof buffer);
    strncpy(text, words, (size_t)n - 1);
    text[n - 1] = 0;
}

int castnet_is_full(int number)
{
    return number == ENOSPC || number == EDQUOT || number == EFBIG;
}

int castnet_exists_code(void) { return EEXIST; }
