/* The last net under the program: whatever ends it other than castnet_end_process is a bug
 * of ours, and the user is told so in a sentence or two and with exit code 1, not by a
 * language's backtrace or by a code that means something else.
 *
 * Two ways lead here: a signal of the processor or of the C library (a wild address, an
 * abort), and the Fortran runtime, which says its sentence and calls exit with a code of
 * its own. Nothing is repaired: the files are as a kill would have left them, and those
 * are made for that.
 */
#define _GNU_SOURCE
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static volatile sig_atomic_t ending = 0; /* castnet_end_process was called */

static void say(const char *text)
{
    size_t n = strlen(text);
    while (n > 0) {
        ssize_t done = write(STDERR_FILENO, text, n);
        if (done <= 0) return;
        text += done;
        n -= (size_t)done;
    }
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
    exit(code);
}
