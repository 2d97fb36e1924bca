/* A file driver for HDF5 that keeps a file readable at every moment, though its writer is
 * killed at any.
 *
 * HDF5 forces a file out as some dozens of writes in no helpful order: between the first
 * and the last of them a tree may point at a node that is not there yet, or behind the
 * end of the file that the superblock knows. A kill in between leaves a file that nobody
 * can open (seen in 5 of 100 kills of a run that wrote frames as fast as it could).
 *
 * Here a write behind the end that readers know may go to the disk at any time: nothing on
 * the disk refers to it. Small ones gather in memory, so that some hundred of them become
 * one. A write before that end waits in memory until HDF5 has forced everything out. Then
 * all that waits is written in an order that leaves the file whole after each single write:
 *   1. the superblock with the new end of the file (the file has already grown),
 *   2. values and heaps (they fill parts of blocks that no reader looks at yet),
 *   3. nodes of trees, from the root down,
 *   4. all else, the lengths of the datasets, what was made last first: a group tells how
 *      many steps there are after the datasets of the steps do.
 * These few writes are done by a short-lived child process that shares this one's
 * memory, so that a kill of this process does not even come between them. For the same
 * reason HDF5 is not told to set blocks aside for small things: everything new lies behind
 * the end.
 *
 * A reader is no less in the way: it has read some blocks before a commit and reads others
 * after it, and must find everything that the earlier ones name.
 *   - A node of a tree that was split has lost what its new sister holds, of which a reader
 *     with the old parent knows nothing. So a node that became shorter is written last, some
 *     milliseconds after all else: till then both hold it.
 *   - A block may reach over two pages, and a reader sees each at its own time. What is
 *     added to a block is told of at its beginning, so its pages are written from the last
 *     to the first, and read the other way round.
 *   - A reader refuses whatever lies behind the end that it read in the superblock: after
 *     every commit an old reader would fail at the new data. So the superblock tells an end
 *     that lies `slack` bytes behind the true one while the file is open (and a mark, in a
 *     byte that the format leaves free, that it does).
 *   - A reader asks for the file's length before it reads the superblock, and calls the file
 *     truncated if the end lies behind that (seen once on a slow machine). So while the file
 *     is open it is longer still, by a hole that takes no room on the disk; close cuts it
 *     off. Readers allow a file to be longer than its end.
 * Old groups cannot be added to in this way: their names stand in a heap whose head and body
 * are read one after the other. castnet makes all groups before the file has its name, and
 * such as grow later in the newer form, where a link is a message in the group's header.
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
#include <time.h>
#include <unistd.h>
#if H5_VERSION_GE(1, 13, 0)
#include <H5FDdevelop.h>
#endif

/* More than many commits let a usual file grow by [B]; and the mark of a superblock that
 * tells so much too much. */
enum { slack_mark = 24 };
static const haddr_t slack = (haddr_t)1 << slack_mark;

/* More than a reader takes from one block to the next. */
static const struct timespec grace = {0, 5000000};

/* Of a superblock of version 0: what is read here, its free byte, the end of the file. */
enum { block_bytes = 48, mark_at = 15, end_at = 40, page = 4096 };

/* What gathers behind the end at most, and the size from which a write goes out by itself [B]. */
static const size_t most_gathered = (size_t)1 << 20, large_write = (size_t)1 << 15;

typedef struct {
    haddr_t address;
    size_t size;
    int rank; /* place in the order of writing */
    int shorter; /* a node with fewer entries than on the disk */
    unsigned char *bytes;
} waiting_t;

typedef struct {
    H5FD_t pub; /* HDF5's own part, first */
    int fd;
    haddr_t eoa;       /* end of what HDF5 has allocated */
    haddr_t eof;       /* end of what is written */
    haddr_t length;    /* of the file on the disk, the hole behind its end included */
    haddr_t known_end; /* end that readers know: what lies behind is free to write */
    haddr_t gathered_at; /* what gathers: bytes from here on, none of which is on the disk */
    size_t n_gathered, gathered_room;
    unsigned char *gathered;
    dev_t device;
    ino_t inode;
    int is_plain;      /* its superblock is of version 0: the end may be told too large */
    haddr_t told_end;  /* by the superblock on the disk */
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

/* ---- what gathers behind the end -------------------------------------------------- */

/* Write what has gathered. From here on it gathers behind it. */
static int write_gathered(safe_file_t *file)
{
    if (file->n_gathered == 0) return 0;
    haddr_t end = file->gathered_at + file->n_gathered;
    int status = write_at(file->fd, file->gathered, file->n_gathered, file->gathered_at);
    if (status != 0) return status;
    if (file->length < end) file->length = end;
    file->gathered_at = end;
    file->n_gathered = 0;
    return 0;
}

/* Have a write behind the end that readers know gather, or do it. Gaps between writes are
 * blocks that HDF5 has not filled: zeros. */
static int write_behind(safe_file_t *file, haddr_t address, size_t n, const unsigned char *bytes)
{
    int status = 0;
    if (file->n_gathered == 0 && file->gathered_at < file->known_end) file->gathered_at = file->known_end;
    int gathers = n < large_write && address >= file->gathered_at && address + n - file->gathered_at <= most_gathered;
    if (!gathers && address + n > file->gathered_at) {
        /* It lies over what gathers, or behind: that goes first. */
        status = write_gathered(file);
        if (status != 0) return status;
        gathers = n < large_write && address >= file->gathered_at;
        if (gathers) file->gathered_at = address;
    }
    if (!gathers) {
        status = write_at(file->fd, bytes, n, address);
        if (status != 0) return status;
        if (file->gathered_at < address + n) file->gathered_at = address + n;
        if (file->length < address + n) file->length = address + n;
        return 0;
    }
    size_t offset = (size_t)(address - file->gathered_at), end = offset + n;
    if (end > file->gathered_room) {
        size_t room = file->gathered_room == 0 ? large_write : file->gathered_room;
        while (room < end) room *= 2;
        unsigned char *larger = realloc(file->gathered, room);
        if (larger == NULL) return ENOMEM;
        file->gathered = larger;
        file->gathered_room = room;
    }
    if (offset > file->n_gathered) memset(file->gathered + file->n_gathered, 0, offset - file->n_gathered);
    memcpy(file->gathered + offset, bytes, n);
    if (end > file->n_gathered) file->n_gathered = end;
    return 0;
}

/* ---- the order of what waits ---------------------------------------------------- */

enum { rank_values = 1, rank_rest = 1000 };

/* See the head of this file. A tree's node starts with 'TREE', its type and its level. */
static int rank_of(H5FD_mem_t type, haddr_t address, const unsigned char *bytes, size_t n)
{
    if (address == 0) return 0;
    if (type == H5FD_MEM_DRAW || type == H5FD_MEM_GHEAP || type == H5FD_MEM_LHEAP) return rank_values;
    if (n >= 6 && memcmp(bytes, "TREE", 4) == 0) return rank_values + 1 + (255 - bytes[5]);
    return rank_rest;
}

static int compare_waiting(const void *a, const void *b)
{
    const waiting_t *x = a, *y = b;
    if (x->rank != y->rank) return x->rank < y->rank ? -1 : 1;
    if (x->rank == rank_rest) return x->address > y->address ? -1 : x->address < y->address;
    return x->address < y->address ? -1 : x->address > y->address;
}

/* From its last page to its first. */
static int write_pages(int fd, const unsigned char *bytes, size_t n, haddr_t address)
{
    while (n > 0) {
        haddr_t first = (address + n - 1) / page * page;
        if (first < address) first = address;
        size_t before = (size_t)(first - address);
        int status = write_at(fd, bytes + before, n - before, first);
        if (status != 0) return status;
        n = before;
    }
    return 0;
}

/* Write all that waits, what became shorter last, when readers that were between two blocks
 * are done; only calls that a child of vfork may make. */
static int write_waiting(const safe_file_t *file)
{
    size_t n_shorter = 0;
    for (int shorter = 0; shorter <= 1; shorter++) {
        if (shorter && n_shorter > 0) (void)nanosleep(&grace, NULL);
        for (size_t i = 0; i < file->n_waiting; i++) {
            const waiting_t *w = &file->waiting[i];
            int status = 0;
            n_shorter += (size_t)(!shorter && w->shorter);
            if (w->shorter != shorter) continue;
            if (w->rank == rank_values) status = write_at(file->fd, w->bytes, w->size, w->address);
            else status = write_pages(file->fd, w->bytes, w->size, w->address);
            if (status != 0) return status;
        }
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

/* Does this node of a tree have fewer entries than on the disk? Their number follows its
 * type and level. A root that gets a new level is not meant: its entries are in the nodes
 * below, which are new. */
static int became_shorter(const safe_file_t *file, const waiting_t *w)
{
    unsigned char old[8];
    if (w->rank <= rank_values || w->rank >= rank_rest) return 0;
    if (pread(file->fd, old, sizeof old, (off_t)w->address) != sizeof old || memcmp(old, "TREE", 4) != 0) return 0;
    if (w->bytes[5] != old[5]) return 0;
    return (w->bytes[6] | w->bytes[7] << 8) < (old[6] | old[7] << 8);
}

/* Does HDF5's own superblock wait? It tells the true end. */
static int waits_at_start(const safe_file_t *file)
{
    for (size_t i = 0; i < file->n_waiting; i++)
        if (file->waiting[i].address == 0) return 1;
    return 0;
}

static int set_length(safe_file_t *file, haddr_t length)
{
    if (file->length == length) return 0;
    if (ftruncate(file->fd, (off_t)length) != 0) return errno;
    file->length = length;
    return 0;
}

/* Bytes between the true end and the one told: none where a limit on the size of files
 * would be hit, or the superblock is of a kind that has a checksum. */
static haddr_t lead(const safe_file_t *file)
{
    struct rlimit limit;
    if (!file->is_plain) return 0;
    if (getrlimit(RLIMIT_FSIZE, &limit) != 0 || limit.rlim_cur == RLIM_INFINITY) return slack;
    return file->eoa + 3 * slack < (haddr_t)limit.rlim_cur ? slack : 0;
}

/* From the disk, zeros behind its end, and over it what gathers and what waits. */
static int read_through(const safe_file_t *file, haddr_t address, size_t n, unsigned char *to)
{
    size_t done = 0;
    while (done < n) {
        ssize_t got = pread(file->fd, to + done, n - done, (off_t)(address + done));
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return errno;
        if (got == 0) break;
        done += (size_t)got;
    }
    memset(to + done, 0, n - done);
    if (file->n_gathered > 0 && file->gathered_at < address + n && address < file->gathered_at + file->n_gathered) {
        haddr_t low = file->gathered_at > address ? file->gathered_at : address;
        haddr_t last = file->gathered_at + file->n_gathered;
        haddr_t high = last < address + n ? last : address + n;
        memcpy(to + (low - address), file->gathered + (low - file->gathered_at), (size_t)(high - low));
    }
    for (size_t i = 0; i < file->n_waiting; i++) {
        const waiting_t *w = &file->waiting[i];
        haddr_t low = w->address > address ? w->address : address;
        haddr_t high = w->address + w->size < address + n ? w->address + w->size : address + n;
        if (low < high) memcpy(to + (low - address), w->bytes + (low - w->address), (size_t)(high - low));
    }
    return 0;
}

static int keep(safe_file_t *file, H5FD_mem_t type, haddr_t address, size_t n, const unsigned char *bytes);
static void look_at_superblock(safe_file_t *file);

/* Have the superblock tell an end that lies `by` behind the true one. */
static int tell_end(safe_file_t *file, haddr_t by)
{
    unsigned char block[block_bytes];
    haddr_t end = file->eoa + by;
    if (!file->is_plain) return 0;
    if (read_through(file, 0, sizeof block, block) != 0) return EIO;
    block[mark_at] = by > 0 ? slack_mark : 0;
    for (int i = 0; i < 8; i++) block[end_at + i] = (unsigned char)(end >> 8 * i);
    return keep(file, H5FD_MEM_SUPER, 0, sizeof block, block);
}

/* Make what readers see the same as what HDF5 means. The hole is made anew when half of what
 * no end told reaches has been written to; a file system that refuses it goes without. */
static int commit(safe_file_t *file, int closing)
{
    int status = write_gathered(file);
    if (status != 0) return status;
    if (file->known_end == 0) look_at_superblock(file);
    haddr_t by = closing ? 0 : lead(file);
    if (by > 0 && file->length < file->eoa + by + slack / 2 && set_length(file, file->eoa + by + slack) != 0) by = 0;
    if (file->length < file->eoa) status = set_length(file, file->eoa);
    if (status != 0) return status;
    file->eof = file->eoa;
    if (file->told_end != file->eoa + by || waits_at_start(file)) status = tell_end(file, by);
    if (status != 0) return status;
    if (file->n_waiting > 0) {
        for (size_t i = 0; i < file->n_waiting; i++) file->waiting[i].shorter = became_shorter(file, &file->waiting[i]);
        qsort(file->waiting, file->n_waiting, sizeof *file->waiting, compare_waiting);
        status = write_waiting_in_child(file);
    }
    if (status != 0) return status;
    forget_waiting(file);
    file->told_end = file->eoa + by;
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
    file->waiting[kept] = (waiting_t){first, (size_t)(last - first), rank_of(type, first, whole, (size_t)(last - first)), 0, whole};
    file->n_waiting = kept + 1;
    return 0;
}

/* ---- what HDF5 calls ------------------------------------------------------------- */

/* What the superblock of a file that is there says: is it plain, which end does it tell, and
 * which is the true one (the file's length where it tells none)? Behind the true end may be
 * the hole that a killed writer left. */
static void look_at_superblock(safe_file_t *file)
{
    static const unsigned char signature[8] = {0x89, 'H', 'D', 'F', '\r', '\n', 0x1a, '\n'};
    unsigned char block[block_bytes];
    haddr_t end = 0;
    file->is_plain = 0;
    file->eof = file->told_end = file->length;
    if (pread(file->fd, block, sizeof block, 0) != sizeof block || memcmp(block, signature, 8) != 0) return;
    int at = block[8] == 0 ? end_at : block[8] == 2 || block[8] == 3 ? 28 : -1;
    if (at < 0 || block[at == end_at ? 13 : 9] != 8) return;
    for (int i = 7; i >= 0; i--) end = end << 8 | block[at + i];
    file->is_plain = at == end_at;
    if (end == 0 || end > file->length) return;
    file->eof = file->told_end = end;
    if (file->is_plain && block[mark_at] > 0 && block[mark_at] < 40 && end > (haddr_t)1 << block[mark_at])
        file->eof -= (haddr_t)1 << block[mark_at];
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
    look_at_superblock(file);
    file->eoa = file->known_end = file->eof;
    /* HDF5 is to read the true end; a lack of memory shows again when it does */
    if (file->told_end != file->eof) (void)tell_end(file, 0);
    file->eoa = 0;
    file->device = s.st_dev;
    file->inode = s.st_ino;
    return &file->pub;
}

/* Cut the file to its end when nobody has it open: some readers ask for the length after
 * they have read the end, and that may have been the old one. A lease says whether there
 * are any, and holds new ones back meanwhile; it is told of them by a signal, of which
 * SIGURG alone does nothing. After half a second they have had their time. */
static int cut_hole(safe_file_t *file)
{
    int leased = 0;
    if (file->length == file->eoa) return 0;
    (void)fcntl(file->fd, F_SETSIG, SIGURG);
    for (int i = 0; i < 100 && !leased; i++) {
        leased = fcntl(file->fd, F_SETLEASE, F_WRLCK) == 0;
        int others = leased || errno == EAGAIN || errno == EBUSY;
        if (!leased) (void)nanosleep(&grace, NULL);
        if (!others) break;
    }
    int status = set_length(file, file->eoa);
    if (leased) (void)fcntl(file->fd, F_SETLEASE, F_UNLCK);
    return status;
}

static herr_t safe_close(H5FD_t *pub)
{
    safe_file_t *file = (safe_file_t *)pub;
    int status = commit(file, 1);
    if (status == 0) status = cut_hole(file);
    forget_waiting(file);
    free(file->waiting);
    free(file->gathered);
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
    /* no sieve: it would write a whole chunk for each number that is added to it;
     * no aggregation: see the head of this file */
    *flags = H5FD_FEAT_POSIX_COMPAT_HANDLE | H5FD_FEAT_DEFAULT_VFD_COMPATIBLE;
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

static herr_t safe_read(H5FD_t *pub, H5FD_mem_t type, hid_t dxpl, haddr_t address, size_t n, void *buffer)
{
    (void)type;
    (void)dxpl;
    return read_through((const safe_file_t *)pub, address, n, buffer) == 0 ? 0 : -1;
}

static herr_t safe_write(H5FD_t *pub, H5FD_mem_t type, hid_t dxpl, haddr_t address, size_t n, const void *buffer)
{
    safe_file_t *file = (safe_file_t *)pub;
    int status;
    (void)dxpl;
    if (address >= file->known_end) {
        status = write_behind(file, address, n, buffer);
        if (status == 0 && address + n > file->eof) file->eof = address + n;
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
    int status = commit((safe_file_t *)pub, 0);
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

/* Have a file access property list use the driver. It stays registered to the end of the
 * process: HDF5 1.10 closes a file through its driver after it has let go of that (a read of
 * freed memory when it was the last to hold it; found by valgrind). */
int castnet_use_safe_driver(hid_t access)
{
    static hid_t driver = -1;
    if (driver < 0 || H5Iget_type(driver) != H5I_VFL) driver = H5FDregister(&safe_driver);
    if (driver < 0) return -1;
    return H5Pset_driver(access, driver, NULL) < 0 ? -1 : 0;
}
