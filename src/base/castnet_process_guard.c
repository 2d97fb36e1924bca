/* How the process speaks and ends.
 *
 * Whatever ends it other than castnet_end_process is a bug of ours, and the user is told so
 * in a sentence or two and with exit code 1, not by a language's backtrace or by a code that
 * means something else.
 *
 * Two ways lead here: a signal of the processor or of the C library (a wild address, an
 * abort), and the Fortran runtime, which says its sentence and calls exit with a code of
 * its own. Nothing is repaired: the files are as a kill would have left them, and those
 * are made for that.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <pthread.h>
#include <signal.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static volatile sig_atomic_t ending = 0;        /* castnet_end_process was called */
static volatile sig_atomic_t output_failed = 0; /* errno of a write to standard output */

/* 0 or errno. */
static int put(int where, const char *text, int64_t n)
{
    while (n > 0) {
        ssize_t done = write(where, text, (size_t)n);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) return errno;
        text += done;
        n -= done;
    }
    return 0;
}

extern volatile size_t castnet_refused_bytes; /* castnet_aligned_malloc.c */

static void say(const char *text) { put(STDERR_FILENO, text, (int64_t)strlen(text)); }

/* Results for standard output. Fortran's own flush is silent on a full disk; here what
 * could not be written is remembered, and castnet_end_process tells it. */
void castnet_print(const char *text, int64_t n)
{
    if (output_failed == 0) output_failed = put(STDOUT_FILENO, text, n);
}

static void say_what_to_do(void)
{
    say("castnet: what was written stays, and a run goes on from its last checkpoint with --restart; please report the "
        "command, the scene and what 'castnet version' prints\n");
}

/* Did memory run out? That is no bug of ours. Only calls that a signal handler may make. */
static int say_memory_ran_out(void)
{
    char digits[24];
    int n = (int)sizeof digits - 1;
    size_t mebibytes = castnet_refused_bytes / 1048576 + 1;
    if (castnet_refused_bytes == 0) return 0;
    for (digits[n] = 0; mebibytes > 0 && n > 0; mebibytes /= 10) digits[--n] = (char)('0' + mebibytes % 10);
    say("castnet: memory ran out: ");
    say(digits + n);
    say(" MiB more were refused; raise the limit (ulimit -v, or the job's), end other programs, or take a smaller net or study\n"
        "castnet: what was written stays, and a run goes on from its last checkpoint with --restart\n");
    return 1;
}

static _Thread_local uintptr_t stack_end = 0; /* the lowest address of this thread's stack; 0: not known */

/* Did a wild address lie where the stack of this thread would go on? */
static int is_stack_full(int number, const siginfo_t *info)
{
    uintptr_t at = (uintptr_t)info->si_addr;
    return number == SIGSEGV && info->si_code > 0 && stack_end > 0 && at < stack_end + (1u << 16) && at + (1u << 26) > stack_end;
}

/* Only calls that a signal handler may make. */
static void on_crash(int number, siginfo_t *info, void *context)
{
    (void)context;
    if (is_stack_full(number, info)) {
        say("castnet: the stack of a thread is full; allow more with OMP_STACKSIZE=256M (other threads) or ulimit -s unlimited "
            "(the first)\n");
        say_what_to_do();
        _exit(1);
    }
    if (number == SIGILL) {
        say("castnet: this program was built for another kind of processor; build it again on this machine "
            "(fpm @release)\n");
        _exit(1);
    }
    if (say_memory_ran_out()) _exit(1);
    say("castnet: a bug of ours: the program ");
    say(number == SIGSEGV || number == SIGBUS ? "reached outside its memory"
        : number == SIGFPE ? "divided where it must not" : "was aborted");
    say(" and has ended\n");
    say_what_to_do();
    _exit(1);
}

static void on_exit_of_another(void)
{
    if (ending) return;
    if (say_memory_ran_out()) _exit(1);
    say("castnet: a bug of ours: the program could not go on\n");
    say_what_to_do();
    _exit(1);
}

/* Words for standard error. Where they cannot be written there is nobody to tell: a run
 * does not end because the disk of its log is full. */
void castnet_print_error(const char *text, int64_t n) { put(STDERR_FILENO, text, n); }

/* An overflown stack has no room for a handler: each thread gets other room for it, to the
 * end of the process, as the threads of a team are there to its end. */
void castnet_guard_thread(void)
{
    static const size_t room = 64 * 1024;
    static _Thread_local void *aside = NULL;
    pthread_attr_t attributes;
    stack_t stack;
    void *low;
    size_t size;
    if (aside != NULL) return;
    aside = malloc(room);
    if (aside == NULL) return;
    if (pthread_getattr_np(pthread_self(), &attributes) == 0) {
        if (pthread_attr_getstack(&attributes, &low, &size) == 0) stack_end = (uintptr_t)low;
        pthread_attr_destroy(&attributes);
    }
    memset(&stack, 0, sizeof stack);
    stack.ss_sp = aside;
    stack.ss_size = room;
    (void)sigaltstack(&stack, NULL);
}

void castnet_guard_process(void)
{
    static const int caught[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT};
    struct sigaction action;
    castnet_guard_thread();
    memset(&action, 0, sizeof action);
    action.sa_sigaction = on_crash;
    action.sa_flags = SA_RESETHAND | SA_SIGINFO | SA_ONSTACK;
    sigemptyset(&action.sa_mask);
    for (size_t i = 0; i < sizeof caught / sizeof caught[0]; i++) sigaction(caught[i], &action, NULL);
    atexit(on_exit_of_another);
}

void castnet_end_process(int code)
{
    ending = 1;
    if (output_failed != 0 && code == 0) {
        say("castnet: standard output could not be written in full: ");
        say(strerror(output_failed));
        say("\n");
        code = 4;
    }
    exit(code);
}
