/* A file driver for HDF5 that keeps a file readable at every moment, though its writer is
 * killed at any.
 *
 * HDF5 forces a file out as some dozens of writes in no helpful order: between the first
 * and the last of them a tree may point at a node that is not there yet, or behind the
 * end of the file that the superblock knows. A kill in between leaves a file that nobody
 * can open (seen in 5 of 100 kills of a run that wrote frames as fast as it could).
 *
 * Here a write behind the end that readers know goes to the disk at once: nothing on the
 * disk refers to it. A write before it waits in memory until HDF5 has forced everything
 * out. Then all that waits is written in an order that leaves the file whole after each
 * single write:
 *   1. the superblock with the new end of the file (the file has already grown),
 *   2. values (they fill parts of blocks that no reader looks at yet),
 *   3. nodes of trees, from the root down (a node that is split keeps what moved out of
 *      it until its parent knows the new place),
 *   4. all else, among it the lengths of the datasets.
 * These few writes are done by a short-lived child process that shares this one's
 * memory, so that a kill of this process does not even come between them.
 *
 * A reader asks for the file's length and then reads the superblock. If a commit comes
 * between the two, the end that it reads lies behind the length it was told, and it calls
 * the file truncated (seen once on a slow machine). So while the file is open it is kept
 * longer than its end by a hole of `slack` bytes, which takes no room on the disk; close
 * cuts it off. Readers allow a file to be longer than its end.
 *
 * One writer, no locks: castnet's own lock file sees to that.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <fcntl.h>
#include <hdf5.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>
#if H5_VERSION_GE(1, 13, 0)
#include <H5FDdevelop.h>
#endif

/* More than one commit lets a usual file grow by [B]. */
static const haddr_t slack = (haddr_t)1 << 22;

typedef struct {
    haddr_t address;
    size_t size;
    int rank; /* place in the order of writing */
    unsigned char *bytes;
} waiting_t;

typedef struct {
    H5FD_t pub; /* HDF5's own part, first */
    int fd;
    haddr_t eoa;       /* end of what HDF5 has allocated */
    haddr_t eof;       /* end of what is written */
    haddr_t length;    /* of the file on the disk, the hole behind its end included */
    haddr_t known_end; /* end that readers know: what lies behind is free to write */
    dev_t device;
    ino_t inode;
    waiting_t *waiting; /* writes that wait, none overlapping another */
    size_t n_waiting, room;
} safe_file_t;

static int write_at(int fd, const unsigned char *bytes, size_t n, haddr_t address)
{
    while (n > 0) {
        ssize_t done = pwrite(fd, bytes, n > (1u << 30) ? (1u << 30) : n, (off_t)address);
        if (done < 0) {
            if (errno == EINTR) continue;
            return errno;
        }
        bytes += done;
        n -= (size_t)done;
        address += (haddr_t)done;
    }
    return 0;
}

/* ---- the order of what waits ---------------------------------------------------- */

/* See the head of this file. A tree's node starts with 'TREE', its type and its level. */
static int rank_of(H5FD_mem_t type, haddr_t address, const unsigned char *bytes, size_t n)
{
    if (address == 0) return 0;
    if (type == H5FD_MEM_DRAW) return 1;
    if (n >= 6 && memcmp(bytes, "TREE", 4) == 0) return 2 + (255 - bytes[5]);
    return 1000;
}

static int compare_waiting(const void *a, const void *b)
{
    const waiting_t *x = a, *y = b;
    if (x->rank != y->rank) return x->rank < y->rank ? -1 : 1;
    return x->address < y->address ? -1 : x->address > y->address;
}

/* Write all that waits; only calls that a child of vfork may make. */
static int write_waiting(const safe_file_t *file)
{
    for (size_t i = 0; i < file->n_waiting; i++) {
        const waiting_t *w = &file->waiting[i];
        int status = write_at(file->fd, w->bytes, w->size, w->address);
        if (status != 0) return status;
    }
    return 0;
}

/* The same in a child. Signals are held back meanwhile: the child's share this process's
 * handlers and memory. What the child cannot do is done here: writing twice does no harm. */
static int write_waiting_in_child(const safe_file_t *file)
{
    sigset_t all, before;
    int status = 0;
    volatile int done = 0;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    pid_t child = vfork();
    if (child == 0) _exit(write_waiting(file) == 0 ? 0 : 1);
    if (child > 0) {
        pid_t seen;
        do {
            seen = waitpid(child, &status, 0);
        } while (seen < 0 && errno == EINTR);
        done = seen == child && WIFEXITED(status) && WEXITSTATUS(status) == 0;
    }
    pthread_sigmask(SIG_SETMASK, &before, NULL);
    return done ? 0 : write_waiting(file);
}

static void forget_waiting(safe_file_t *file)
{
    for (size_t i = 0; i < file->n_waiting; i++) free(file->waiting[i].bytes);
    file->n_waiting = 0;
}

static int set_length(safe_file_t *file, haddr_t length)
{
    if (file->length == length) return 0;
    if (ftruncate(file->fd, (off_t)length) != 0) return errno;
    file->length = length;
    return 0;
}

/* Bytes that the hole may have: none where a limit on the size of files would be hit. */
static haddr_t hole(const safe_file_t *file)
{
    struct rlimit limit;
    if (getrlimit(RLIMIT_FSIZE, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return slack;
    return file->eoa + 2 * slack < (haddr_t)limit.rlim_cur ? slack : 0;
}

/* Make what readers see the same as what HDF5 means. The hole is made anew when half of it
 * has been written to; a file system that refuses it goes without. */
static int commit(safe_file_t *file)
{
    int status = 0;
    if (file->length < file->eoa + slack / 2 && hole(file) > 0) (void)set_length(file, file->eoa + slack);
    if (file->length < file->eoa) status = set_length(file, file->eoa);
    if (status != 0) return status;
    file->eof = file->eoa;
    if (file->n_waiting > 0) {
        qsort(file->waiting, file->n_waiting, sizeof *file->waiting, compare_waiting);
        status = write_waiting_in_child(file);
    }
    if (status != 0) return status;
    forget_waiting(file);
    file->known_end = file->eoa;
    return 0;
}

/* Keep a write until the commit. What overlaps it becomes one with it. */
static int keep(safe_file_t *file, H5FD_mem_t type, haddr_t address, size_t n, const unsigned char *bytes)
{
    haddr_t first = address, last = address + n;
    size_t i = 0, kept = 0;
    for (i = 0; i < file->n_waiting; i++) {
        waiting_t *w = &file->waiting[i];
        if (w->address < last && address < w->address + w->size) {
            if (w->address == address && w->size == n) {
                memcpy(w->bytes, bytes, n);
                w->rank = rank_of(type, address, w->bytes, n);
                return 0;
            }
            if (w->address < first) first = w->address;
            if (w->address + w->size > last) last = w->address + w->size;
        }
    }
    unsigned char *whole = malloc((size_t)(last - first));
    if (whole == NULL) return ENOMEM;
    if (file->n_waiting == file->room) {
        size_t room = file->room == 0 ? 64 : 2 * file->room;
        waiting_t *larger = realloc(file->waiting, room * sizeof *larger);
        if (larger == NULL) {
            free(whole);
            return ENOMEM;
        }
        file->waiting = larger;
        file->room = room;
    }
    /* the stretched range holds nothing but what overlaps: two that wait never overlap,
     * and each of them reaches into the new write */
    for (i = 0; i < file->n_waiting; i++) {
        waiting_t *w = &file->waiting[i];
        if (w->address < address + n && address < w->address + w->size) {
            memcpy(whole + (w->address - first), w->bytes, w->size);
            free(w->bytes);
        } else {
            file->waiting[kept++] = *w;
        }
    }
    memcpy(whole + (address - first), bytes, n);
    file->waiting[kept] = (waiting_t){first, (size_t)(last - first), rank_of(type, first, whole, (size_t)(last - first)), whole};
    file->n_waiting = kept + 1;
    return 0;
}

/* ---- what HDF5 calls ------------------------------------------------------------- */

/* The end that a file's superblock tells (versions 0, 2 and 3; `length` where it is of no
 * such file or ends before): behind it may be the hole that a killed writer left. */
static haddr_t stored_end(int fd, haddr_t length)
{
    static const unsigned char signature[8] = {0x89, 'H', 'D', 'F', '\r', '\n', 0x1a, '\n'};
    unsigned char block[48];
    haddr_t end = 0;
    if (pread(fd, block, sizeof block, 0) != sizeof block || memcmp(block, signature, 8) != 0) return length;
    int at = block[8] == 0 ? 40 : block[8] == 2 || block[8] == 3 ? 28 : -1;
    if (at < 0 || block[at == 40 ? 13 : 9] != 8) return length;
    for (int i = 7; i >= 0; i--) end = end << 8 | block[at + i];
    return end > 0 && end < length ? end : length;
}

static H5FD_t *safe_open(const char *name, unsigned flags, hid_t fapl, haddr_t maxaddr)
{
    struct stat s;
    int mode = (flags & H5F_ACC_RDWR) ? O_RDWR : O_RDONLY;
    (void)fapl;
    (void)maxaddr;
    if (flags & H5F_ACC_TRUNC) mode |= O_TRUNC;
    if (flags & H5F_ACC_CREAT) mode |= O_CREAT;
    if (flags & H5F_ACC_EXCL) mode |= O_EXCL | O_NOFOLLOW;
    int fd = open(name, mode | O_CLOEXEC, 0644);
    if (fd < 0) return NULL;
    safe_file_t *file = calloc(1, sizeof *file);
    if (file == NULL || fstat(fd, &s) != 0) {
        free(file);
        close(fd);
        return NULL;
    }
    file->fd = fd;
    file->length = (haddr_t)s.st_size;
    file->eof = file->known_end = stored_end(fd, file->length);
    file->device = s.st_dev;
    file->inode = s.st_ino;
    return &file->pub;
}

static herr_t safe_close(H5FD_t *pub)
{
    safe_file_t *file = (safe_file_t *)pub;
    int status = commit(file);
    if (status == 0) status = set_length(file, file->eoa);
    forget_waiting(file);
    free(file->waiting);
    if (close(file->fd) != 0 && status == 0) status = errno;
    free(file);
    errno = status;
    return status == 0 ? 0 : -1;
}

static int safe_cmp(const H5FD_t *a, const H5FD_t *b)
{
    const safe_file_t *x = (const safe_file_t *)a, *y = (const safe_file_t *)b;
    if (x->device != y->device) return x->device < y->device ? -1 : 1;
    return x->inode < y->inode ? -1 : x->inode > y->inode;
}

static herr_t safe_query(const H5FD_t *pub, unsigned long *flags)
{
    (void)pub;
    /* no sieve: it would write a whole chunk for each number that is added to it */
    *flags = H5FD_FEAT_AGGREGATE_METADATA | H5FD_FEAT_AGGREGATE_SMALLDATA | H5FD_FEAT_POSIX_COMPAT_HANDLE
             | H5FD_FEAT_DEFAULT_VFD_COMPATIBLE;
    return 0;
}

static haddr_t safe_get_eoa(const H5FD_t *pub, H5FD_mem_t type)
{
    (void)type;
    return ((const safe_file_t *)pub)->eoa;
}

static herr_t safe_set_eoa(H5FD_t *pub, H5FD_mem_t type, haddr_t address)
{
    (void)type;
    ((safe_file_t *)pub)->eoa = address;
    return 0;
}

static haddr_t safe_get_eof(const H5FD_t *pub, H5FD_mem_t type)
{
    (void)type;
    return ((const safe_file_t *)pub)->eof;
}

static herr_t safe_get_handle(H5FD_t *pub, hid_t fapl, void **handle)
{
    (void)fapl;
    *handle = &((safe_file_t *)pub)->fd;
    return 0;
}

/* From the disk, zeros behind its end, and over it what waits. */
static herr_t safe_read(H5FD_t *pub, H5FD_mem_t type, hid_t dxpl, haddr_t address, size_t n, void *buffer)
{
    safe_file_t *file = (safe_file_t *)pub;
    unsigned char *to = buffer;
    size_t done = 0;
    (void)type;
    (void)dxpl;
    while (done < n) {
        ssize_t got = pread(file->fd, to + done, n - done, (off_t)(address + done));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return -1;
        if (got == 0) break;
        done += (size_t)got;
    }
    memset(to + done, 0, n - done);
    for (size_t i = 0; i < file->n_waiting; i++) {
        const waiting_t *w = &file->waiting[i];
        haddr_t low = w->address > address ? w->address : address;
        haddr_t high = w->address + w->size < address + n ? w->address + w->size : address + n;
        if (low < high) memcpy(to + (low - address), w->bytes + (low - w->address), (size_t)(high - low));
    }
    return 0;
}

static herr_t safe_write(H5FD_t *pub, H5FD_mem_t type, hid_t dxpl, haddr_t address, size_t n, const void *buffer)
{
    safe_file_t *file = (safe_file_t *)pub;
    int status;
    (void)dxpl;
    if (address >= file->known_end) {
        status = write_at(file->fd, buffer, n, address);
        if (status == 0 && address + n > file->eof) file->eof = address + n;
        if (file->length < file->eof) file->length = file->eof;
    } else {
        status = keep(file, type, address, n, buffer);
    }
    errno = status;
    return status == 0 ? 0 : -1;
}

static herr_t safe_flush(H5FD_t *pub, hid_t dxpl, hbool_t closing)
{
    (void)dxpl;
    (void)closing;
    int status = commit((safe_file_t *)pub);
    errno = status;
    return status == 0 ? 0 : -1;
}

/* The file only grows here; it shrinks, if at all, when what waits has been written. */
static herr_t safe_truncate(H5FD_t *pub, hid_t dxpl, hbool_t closing)
{
    safe_file_t *file = (safe_file_t *)pub;
    (void)dxpl;
    (void)closing;
    if (file->length < file->eoa && set_length(file, file->eoa) != 0) return -1;
    file->eof = file->eoa;
    return 0;
}

static const H5FD_class_t safe_driver = {
#if H5_VERSION_GE(1, 13, 0)
    .version = H5FD_CLASS_VERSION,
    .value = (H5FD_class_value_t)512, /* the first number that is free for anyone */
#endif
    .name = "castnet_safe",
    .maxaddr = ((haddr_t)1 << (8 * sizeof(off_t) - 1)) - 1,
    .fc_degree = H5F_CLOSE_WEAK,
    .open = safe_open,
    .close = safe_close,
    .cmp = safe_cmp,
    .query = safe_query,
    .get_eoa = safe_get_eoa,
    .set_eoa = safe_set_eoa,
    .get_eof = safe_get_eof,
    .get_handle = safe_get_handle,
    .read = safe_read,
    .write = safe_write,
    .flush = safe_flush,
    .truncate = safe_truncate,
    .fl_map = H5FD_FLMAP_DICHOTOMY,
};

/* Have a file access property list use the driver. */
int castnet_use_safe_driver(hid_t access)
{
    hid_t driver = H5FDregister(&safe_driver);
    if (driver < 0) return -1;
    int status = H5Pset_driver(access, driver, NULL) < 0 ? -1 : 0;
    H5FDunregister(driver); /* the list, and the file opened with it, keep it alive */
    return status;
}
