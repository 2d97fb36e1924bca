/* The commit that the program was built from, as the build says it: -DCASTNET_COMMIT=0123abcd
 * among the C flags (tools/setup.sh). In C, because fpm compiles a file again when its flags
 * change: a new commit then costs this file and a link, not the whole program.
 */
#include <string.h>

#define TEXT_(word) #word
#define TEXT(word) TEXT_(word)

#ifdef CASTNET_COMMIT
static const char commit[] = TEXT(CASTNET_COMMIT);
#else
static const char commit[] = "";
#endif

/* Copy the commit without its final zero; returns its length, 0: not known. */
int castnet_commit(char *text, int room) {
  int length = (int)strlen(commit);
  if (length > room) length = room;
  memcpy(text, commit, (size_t)length);
  return length;
}
