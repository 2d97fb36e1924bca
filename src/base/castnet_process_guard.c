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

/* Only calls that a signal handler may make. */
static void on_crash(int number)
{
    if (number == SIGILL) {
        say("castnet: this program was built for another kind of processor; build it again on this machine "
            "(fpm @release)\n");
        _exit(1);
    }
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
    say("castnet: a bug of ours, or memory that ran out: the program could not go on\n");
    say_what_to_do();
    _exit(1);
}

/* Words for standard error. Where they cannot be written there is nobody to tell: a run
 * does not end because the disk of its log is full. */
void castnet_print_error(const char *text, int64_t n) { put(STDERR_FILENO, text, n); }

void castnet_guard_process(void)
{
    static const int caught[] = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT};
    static char aside[64 * 1024]; /* an overflown stack has no room for a handler */
    stack_t stack;
    struct sigaction action;
    memset(&stack, 0, sizeof stack);
    stack.ss_sp = aside;
    stack.ss_size = sizeof aside;
    memset(&action, 0, sizeof action);
    action.sa_handler = on_crash;
    action.sa_flags = SA_RESETHAND | (sigaltstack(&stack, NULL) == 0 ? SA_ONSTACK : 0);
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
